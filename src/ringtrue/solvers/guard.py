"""Runs a program and ends it with all that it started as soon as whoever runs this is gone; nothing
is imported here.

Called as `python -I guard.py PROGRAM ...` in a session of its own. Its standard input is a pipe
whose other end the caller holds: the system closes that with the caller, however it ends.
"""

import os
import signal
import subprocess
import sys
import threading

NOT_STARTED, WHY = (
    127,
    "the program cannot be started: ",
)  # exit status, and how its line in the log begins


def _wait_for_the_end() -> None:
    while os.read(0, 1):
        pass
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    threading.Thread(target=_wait_for_the_end, daemon=True).start()
    try:
        process = subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL)
    except OSError as e:
        os.write(1, f"{WHY}{e.strerror}\n".encode())
        os._exit(NOT_STARTED)
    status = process.wait()
    os._exit(status if status >= 0 else 128 - status)  # of a signal, as a shell has it
