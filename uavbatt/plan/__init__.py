"""Before take-off: how long a pack lasts, and whether a mission fits."""
