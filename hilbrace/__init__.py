"""Design, cast and test soft prophylactic braces from human motion. Research software, not a medical device."""

__version__ = "0.1.0"
