"""A log through the estimator, and what came of it."""
