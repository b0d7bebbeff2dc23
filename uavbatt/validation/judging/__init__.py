"""Judging the tests themselves: corridor, drift, independence of the samples, series over temperature, findings."""
