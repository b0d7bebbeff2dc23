"""Simulated flights, for tests and for those who integrate uavbatt."""
