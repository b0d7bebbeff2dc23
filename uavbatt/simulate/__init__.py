"""Simulated flights and the logs they are written to, for tests and for those who integrate uavbatt."""
