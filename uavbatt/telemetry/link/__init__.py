"""LIVE: frames of a radio link become rows of the vehicle that is followed; who speaks, and who is believed."""
