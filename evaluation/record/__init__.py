"""What the devices sent, on disk: an append-only log that survives a crash, its recovery, and C3D files."""
