"""From answers to tables, words and figures."""
