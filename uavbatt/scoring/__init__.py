"""Scores: forecasts are compared with what happened."""
