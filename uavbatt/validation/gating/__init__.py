"""Gating a model: predictions of tests that it was not fitted to, uncertainty of their bias, claims, verdicts."""
