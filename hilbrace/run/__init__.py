"""Run folders, records on disk, and progress."""
