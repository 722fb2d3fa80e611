"""The command line. The dense algebra of ringtrue is small: one thread of OpenBLAS is faster than
several that wait.
"""

import os

os.environ.setdefault(
    "OPENBLAS_NUM_THREADS", "1"
)  # before numpy is imported; PARDISO keeps its own threads
