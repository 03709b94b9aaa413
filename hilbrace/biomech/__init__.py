"""Biomechanics: from markers and ground reactions to joint angles and net loads."""
