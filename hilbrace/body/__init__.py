"""The subject's skin: a small body model, its fit to a person, and how it follows the bones."""
