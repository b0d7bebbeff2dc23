"""Search: which effect, or which two, explain the records, and what each is worth."""
