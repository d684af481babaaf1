"""Code independent of bone: checks, files, tables, records, studies."""
