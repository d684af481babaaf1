"""What answers show: d', intervals, groups, equivalence, power."""
