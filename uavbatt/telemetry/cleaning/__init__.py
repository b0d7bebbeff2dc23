"""CLEANING: readings in, the same readings out with NaN in place of what a battery cannot have."""
