"""Running an experiment: protocol, files, screen, intervals, subject by subject."""
