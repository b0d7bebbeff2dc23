"""SCORES: forecasts are judged by what happened."""
