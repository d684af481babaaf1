"""The haptic session: recording, reading back, replay and analysis."""
