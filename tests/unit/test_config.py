"""The configuration refuses what it does not know, and says what it does know."""

from __future__ import annotations

from pathlib import Path

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.config import (
    ASSUMED_PASSIVE,
    Config,
    known_keys,
    parse_config,
    passive_stiffness,
    read_config,
)
from hilbrace.errors import ConfigError


def test_an_empty_file_is_a_configuration(tmp_path: Path):
    (tmp_path / "run.toml").write_text("")
    assert read_config(tmp_path / "run.toml") == Config()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"optimize": {"iteration": 3}}, ("unknown key 'optimize.iteration'", "optimize.iterations")),
        ({"optimise": {}}, ("unknown key 'optimise'", "optimize")),
        ({"domain": {"trianlges": 3000}}, ("domain.trianlges", "domain.triangles")),
        ({"domain": {"triangles": 3}}, ("domain.triangles", "greater than or equal to 400")),
        ({"domain": {"side": "middle"}}, ("domain.side", "'left' or 'right'")),
        ({"motion": {"plates": {"1": "both"}}}, ("motion.plates.1", "right")),
        ({"optimize": {"coupling": "spring"}}, ("optimize.coupling", "'stiffness' or 'paper'")),
        ({"optimize": {"prevent": ["valgus"]}}, ("optimize.prevent", "'valgus'", "adduction, rotation")),
        ({"optimize": {"preserve": ["inversion"]}}, ("optimize.preserve", "knee", "flexion")),
        ({"optimize": {"preserve": ["adduction"]}}, ("'adduction' more than once", "one of the two")),
    ],
)
def test_a_wrong_key_or_value_is_named(content, words):
    with pytest.raises(ConfigError) as fault:
        parse_config(content, "run.toml")
    text = fault.value.two_lines()
    assert len(text.splitlines()) == 2
    for word in words:
        assert word in text


@given(
    st.dictionaries(
        st.sampled_from([*Config.model_fields, "extra"]),
        st.dictionaries(
            st.sampled_from([key.split(".")[-1] for key in known_keys()] + ["wrong"]),
            st.one_of(st.integers(), st.floats(allow_nan=False), st.text(max_size=5), st.booleans()),
            max_size=3,
        ),
        max_size=3,
    )
)
def test_any_document_is_valid_or_names_its_key(content):
    refused = None
    try:
        parse_config(content, "run.toml")
    except ConfigError as fault:
        refused = fault
    assert refused is None or "'" in refused.what


def test_an_override_beats_the_file(tmp_path: Path):
    (tmp_path / "run.toml").write_text("[domain]\ntriangles = 1000\n")
    config = read_config(tmp_path / "run.toml", {"domain.triangles": "2000", "domain.side": "right"})
    assert config.domain.triangles == 2000
    assert config.domain.side == "right"


def test_an_override_without_a_section_is_told_where_it_belongs(tmp_path: Path):
    (tmp_path / "run.toml").write_text("")
    with pytest.raises(ConfigError) as fault:
        read_config(tmp_path / "run.toml", {"triangles": "2000"})
    assert "domain.triangles" in fault.value.hint


def test_paths_are_relative_to_the_file(tmp_path: Path):
    (tmp_path / "run.toml").write_text('[motion]\nmarkers = "jump.trc"\nmarker_map = "map.toml"\n')
    config = read_config(tmp_path / "run.toml")
    assert config.motion.markers == tmp_path / "jump.trc"
    assert config.motion.marker_map == str(tmp_path / "map.toml")


def test_the_effective_configuration_reads_back(tmp_path: Path):
    config = parse_config({"motion": {"synthetic": "serve", "window": [0.5, 1.0]}}, "test")
    text = tomli_w.dumps(config.model_dump(mode="json", exclude_none=True))
    (tmp_path / "run.toml").write_text(text)
    assert read_config(tmp_path / "run.toml") == config


def test_broken_toml_names_the_line(tmp_path: Path):
    (tmp_path / "run.toml").write_text("[domain]\ntriangles = \n")
    with pytest.raises(ConfigError, match="line 2"):
        read_config(tmp_path / "run.toml")


def test_cells_are_as_wide_as_one_key_says():
    with pytest.raises(ConfigError, match=r"pattern\.period_mm"):
        parse_config({"pattern": {"scale": 0.08, "period_mm": 80.0}}, "run.toml")


def test_what_is_painted_on_the_skin_belongs_to_the_domains_inputs(tmp_path):
    from hilbrace.pipeline.runner import stage_key
    from hilbrace.pipeline.stages import STAGES

    paint = tmp_path / "spot.txt"
    config = parse_config({"domain": {"reliefs": [{"painted": str(paint), "height_mm": 3.0}]}}, "run.toml")

    def keys(content: str) -> dict[str, str]:
        paint.write_text(content)
        return {stage.name: stage_key(stage, config, {}) for stage in STAGES if stage.name != "motion"}

    first, second = keys("1 2 3"), keys("1 2 4")
    assert first["domain"] != second["domain"]
    assert first["body"] == second["body"]


def test_passive_stiffness_is_the_joints_own_until_it_is_set():
    settings = parse_config({"optimize": {"passive_frontal_nm_per_deg": 7.0}}, "run.toml").optimize
    assert passive_stiffness(settings, "knee") == (0.5, 7.0, 1.5)
    assert passive_stiffness(settings, "ankle")[0] == ASSUMED_PASSIVE["ankle"][0]
