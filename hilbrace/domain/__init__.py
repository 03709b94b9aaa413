"""The design domain: where the brace sits, how its surface is meshed, flattened and moved."""
