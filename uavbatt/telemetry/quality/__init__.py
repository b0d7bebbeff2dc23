"""QUALITY: a flight in, its figures out (charge, gaps, sag), and the judgement if a replay of it can be trusted."""
