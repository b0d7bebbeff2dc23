"""The wire: message fields and their sentinels, frames as bytes, links. It knows nothing of the battery model."""
