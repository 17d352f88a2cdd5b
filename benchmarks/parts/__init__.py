"""What the benchmarks of whole SLAM runs share: what is run, what is asked of it, and on which machine."""
