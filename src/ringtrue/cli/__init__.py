"""The command line. The dense algebra of ringtrue is small: one thread of OpenBLAS is faster than
several that wait.
"""

import os

# before numpy is imported; PARDISO keeps its own threads
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
