"""Fits of battery and vehicle files to bench tests and flights."""
