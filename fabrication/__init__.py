"""Casting molds for a brace: the workshop. Builds on `hilbrace`, never the other way."""
