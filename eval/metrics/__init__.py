"""Scores of a trajectory, in NumPy alone: absolute and relative errors, and hand-checked relations."""
