"""What knows nothing of bone: checks, files, tables, records, studies."""
