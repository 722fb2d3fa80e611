"""Runs a program and ends it with all that it started as soon as whoever runs this is gone; nothing
is imported here.

Called as `python -I guard.py PROGRAM ...` in a session of its own. Its standard input is a pipe
whose other end the caller holds: the system closes that with the caller, however it ends. Where the
program cannot be started, the file `NOT_STARTED` holds the number of the system's error.
"""

import os
import signal
import subprocess
import sys
import threading

NOT_STARTED = "not_started.errno"


def end_with_caller() -> None:
    """Wait until the caller is gone, then end this process and all that it started."""
    while os.read(0, 1):
        pass
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    threading.Thread(target=end_with_caller, daemon=True).start()
    try:
        process = subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL)
    except OSError as e:
        with open(NOT_STARTED, "w") as file:
            file.write(str(e.errno))
        os._exit(127)
    status = process.wait()
    os._exit(status if status >= 0 else 128 - status)  # of a signal, as a shell has it
