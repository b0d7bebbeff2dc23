"""The pack ledger: the evidence of every flight about a pack, kept from flight to flight."""
