"""OUT: what the pipeline knows, to files and to the ground station. Knows records, not batteries."""
