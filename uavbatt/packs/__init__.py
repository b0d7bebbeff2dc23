"""The pack ledger: what every flight taught of a pack, remembered from flight to flight."""
