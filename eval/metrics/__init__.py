"""Scores of a trajectory: absolute and relative errors, hand-checked relations, and residuals of its scans."""
