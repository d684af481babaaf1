"""Virtual descents: the rig, the record, sweeps and the scatter of uneven bone."""
