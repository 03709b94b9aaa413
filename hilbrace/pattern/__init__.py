"""The struts: microstructures drawn on the skin, cleaned for casting, and thickened into the brace."""
