"""Presets fill in what a file leaves out, give way to what it says, and own up to it."""

from __future__ import annotations

from pathlib import Path

import pytest
import tomli_w

from hilbrace.config import PRESETS, Config, departures, known_keys, parse_config, read_config
from hilbrace.config.presets import with_preset
from hilbrace.errors import ConfigError
from hilbrace.pipeline import demo_config


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_is_a_configuration_that_departs_from_itself_nowhere(preset):
    config = parse_config({"preset": preset}, "run.toml")
    assert config.preset == preset
    assert departures(preset, config) == ()


@pytest.mark.parametrize("preset", PRESETS)
def test_every_value_of_a_preset_arrives(preset):
    config = parse_config({"preset": preset}, "run.toml").model_dump(mode="json")

    def arrived(values, found):
        return all(
            arrived(value, found[key]) if isinstance(value, dict) else found[key] == value
            for key, value in values.items()
        )

    assert arrived(PRESETS[preset], config)


def test_no_preset_is_the_default():
    assert parse_config({}, "run.toml") == parse_config({"preset": "default"}, "run.toml") == Config()


def test_the_paper_preset_has_the_papers_figures():
    """Sec. 4.1, 5, 6 and 7.1, read off once more."""
    config = parse_config({"preset": "paper"}, "run.toml")
    optimize = config.optimize
    assert (optimize.sigma, optimize.p_norm, optimize.volume_fraction) == (4.0, 20.0, 0.5)
    assert tuple(optimize.weights.model_dump().values()) == (0.5, 0.8, 0.6, 0.3, 0.02)
    assert (optimize.coupling, optimize.volume, config.domain.flatten) == ("paper", "penalised", "lscm")
    assert (config.material.segmentation, config.pattern.scale) == ("spectral", 0.08)


def test_what_the_file_says_wins_and_is_told():
    content = {"preset": "paper", "optimize": {"sigma": 7.0, "weights": {"seam": 0.5}}}
    config = parse_config(content, "run.toml")
    assert (config.optimize.sigma, config.optimize.weights.seam) == (7.0, 0.5)
    assert config.optimize.weights.compliance == 0.6
    assert departures("paper", config) == (
        "optimize.sigma = 7.0 (preset: 4.0)",
        "optimize.weights.seam = 0.5 (preset: 0.02)",
    )


def test_a_period_of_the_file_replaces_the_scale_of_the_preset():
    config = parse_config({"preset": "paper", "pattern": {"period_mm": 50.0}}, "run.toml")
    assert (config.pattern.period_mm, config.pattern.scale) == (50.0, None)


def test_an_override_names_a_preset(tmp_path: Path):
    (tmp_path / "run.toml").write_text("[optimize]\nsigma = 5\n")
    config = read_config(tmp_path / "run.toml", {"preset": "paper", "optimize.seed": "3"})
    assert (config.preset, config.optimize.sigma, config.optimize.seed) == ("paper", 5.0, 3)
    with pytest.raises(ConfigError, match="no section"):
        read_config(tmp_path / "run.toml", {"preset": "paper", "preset.sigma": "4"})


def test_an_unknown_preset_is_refused_with_the_known_ones():
    for name in ("papr", 3, None):
        with pytest.raises(ConfigError, match="'preset'") as fault:
            parse_config({"preset": name}, "run.toml")
        assert "paper" in fault.value.two_lines()


@pytest.mark.parametrize("content", [{"preset": "paper", "optimize": 3}, {"preset": "paper", "pattern": []}])
def test_a_section_that_is_none_is_named_as_without_a_preset(content):
    with pytest.raises(ConfigError, match=r"optimize|pattern"):
        parse_config(content, "run.toml")


def test_the_document_is_left_as_it_is():
    content = {"preset": "paper", "optimize": {"sigma": 3.0}}
    with_preset(content)
    assert content == {"preset": "paper", "optimize": {"sigma": 3.0}}


@pytest.mark.parametrize("pattern", [{}, {"period_mm": 60.0}])
def test_the_effective_configuration_of_a_preset_reads_back(tmp_path: Path, pattern):
    config = parse_config({"preset": "paper", "pattern": pattern}, "run.toml")
    (tmp_path / "run.toml").write_text(tomli_w.dumps(config.model_dump(mode="json", exclude_none=True)))
    assert read_config(tmp_path / "run.toml") == config


def test_the_paper_walks_at_60_frames_a_second_in_the_demo():
    rates = {
        (motion, preset): demo_config(motion, preset=preset).domain.frames_per_second
        for motion in ("serve", "gait")
        for preset in ("default", "paper")
    }
    assert rates == {
        ("serve", "default"): 15.0,
        ("gait", "default"): 15.0,
        ("serve", "paper"): 15.0,
        ("gait", "paper"): 60.0,
    }


def test_the_preset_is_a_key_of_the_configuration():
    assert "preset" in known_keys()
