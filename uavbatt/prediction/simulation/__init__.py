"""The simulation: possible states and loads, drawn side by side and flown to the end of the pack."""
