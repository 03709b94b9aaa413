"""Measurements of a brace in the laboratory. Builds on `hilbrace`, never the other way."""
