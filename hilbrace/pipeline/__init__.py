"""The seven stages and the report, run in order, each only when something it depends on changed."""

from hilbrace.pipeline.demo import demo_config
from hilbrace.pipeline.runner import read_metrics, run_stages
from hilbrace.pipeline.summary import print_summary

__all__ = ["demo_config", "print_summary", "read_metrics", "run_stages"]
