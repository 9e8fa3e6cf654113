"""Timings on this machine; `python -m benchmarks` prints all of them."""
