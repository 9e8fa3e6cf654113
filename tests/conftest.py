"""Tests run side by side (pytest-xdist), each on one thread: the tensors here are too small to
share among cores.
"""

import os
import signal

os.environ.setdefault("OMP_NUM_THREADS", "1")

# A shell lets its background jobs ignore ctrl-C; the stages under test, which inherit that, must
# not.
signal.signal(signal.SIGINT, signal.default_int_handler)
