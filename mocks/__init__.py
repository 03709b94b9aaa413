"""Stand-ins for laboratory devices: separate processes for tests, never part of the wheel."""
