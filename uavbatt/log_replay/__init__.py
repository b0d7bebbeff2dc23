"""Replay of a log through the estimator, and the result in figures."""
