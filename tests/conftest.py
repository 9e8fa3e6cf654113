"""Tests run side by side (pytest-xdist), each on one thread: the tensors here are too small to share among cores."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
