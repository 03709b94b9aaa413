"""The microstructures and the rubber: what a place of the brace is made of."""
