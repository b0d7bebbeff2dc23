"""Refit: records, the effects that may be added, and the solver that frees their unknowns."""
