"""What costs how much on this machine; `python -m benchmarks` prints everything."""
