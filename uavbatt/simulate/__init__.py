"""Flights that never flew, for tests and for people who integrate us."""
