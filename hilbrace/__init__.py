"""Design, cast and test soft prophylactic braces from human motion. Research software, no medical device."""

__version__ = "0.1.0"
