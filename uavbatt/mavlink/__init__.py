"""The wire: message fields and their sentinels, frames and log records as bytes. Knows no batteries' physics."""
