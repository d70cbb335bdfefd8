"""Least squares, line fits and filters of 2007, on simulated and recorded ranges, and the drawings of its article."""
