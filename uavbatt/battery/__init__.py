"""THE MODEL: equations, effects, pack, state space, first state, battery and vehicle files."""
