"""The temporal bone that is made, not scanned."""
