"""The route: where the aircraft is on it, the legs to come and their power, the way home, the time to turn back."""
