"""THE MODEL: equations, effects, pack, state space, initial state, battery and vehicle files."""
