"""The time left by open autopilots, re-implemented from their equations for a comparison.

Every peer is a module with `predict(samples, capacity_Ah, cells, ...) -> remaining_s`: one number per sample,
seconds, NaN where the peer shows nothing. Each sees only what lies at or before the sample. **Rated** is
the nameplate capacity alone; **calibrated** adds what a careful pilot would have learnt from earlier flights:
`usable_Ah` (or `usable_Wh`), the charge or energy drawn from take-off to the end of those flights.

These are our re-implementations, not the autopilots' code; the autopilot's own logged numbers, where a log has
them, are the better witness. None of the peers gives an interval.
"""
