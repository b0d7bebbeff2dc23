"""The study's own method, equations (1) to (17) as printed, and its agreement with the printed tables."""
