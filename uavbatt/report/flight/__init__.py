"""The page of one flight, and its text for a terminal."""
