"""The page in a real browser: curves move, a lost device turns red, marks land in the recording."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

from evaluation.record.reading import read_log
from mocks import synthetic_study as made_up
from tests.pipeline.live_mocks import LAB, ROOT, vicon, wait_for

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--window-size=1600,900",
)  # fmt: skip

needs_browser = pytest.mark.skipif(
    CHROMIUM is None or DRIVER is None, reason="the Debian packages chromium and chromium-driver are absent"
)


@contextmanager
def browser(folder):
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={folder}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    try:
        yield driver
    finally:
        driver.quit()


@contextmanager
def live(lab, out, *words):
    """``hilbrace evaluate live`` in a process of its own, and the address of its page."""
    process = subprocess.Popen(
        [sys.executable, "-m", "hilbrace", "evaluate", "live", str(lab), "--out", str(out), "--port", "0",
         *words],
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, cwd=ROOT,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    try:
        yield process, re.search(r"http://\S+", process.stderr.readline()).group()
    finally:
        process.terminate()
        try:
            process.communicate(timeout=30)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


@needs_browser
@pytest.mark.slow
def test_the_page_in_a_browser(tmp_path):
    made_up.write_study(tmp_path, seed=3, repeats=1)
    lab = tmp_path / "lab.toml"
    lab.write_text(LAB.format(standing='standing = "standing.c3d"'))
    out, profile = tmp_path / "out", tmp_path / "profile"
    played = str(tmp_path / "unbraced_1.c3d")
    with (
        vicon(played) as mock,
        live(lab, out, "--device", mock.address) as (_, url),
        browser(profile) as page,
    ):
        from selenium.webdriver.common.by import By

        def read(name: str) -> str:
            return page.find_element(By.ID, name).text

        def shown(name: str, what: str) -> float:
            return float(page.find_element(By.ID, name).get_attribute(f"data-{what}") or 0)

        page.get(url)
        wait_for(lambda: shown("knee-plot", "points") > 20 and shown("force-plot", "points") > 20)
        assert page.find_element(By.CSS_SELECTOR, ".device.ok b").text.split() == ["vicon", "OK"]
        before, picture = shown("knee-plot", "end"), drawn(page)
        wait_for(lambda: shown("knee-plot", "end") != before and drawn(page) != picture)
        wait_for(lambda: read("flexion").endswith("\u00b0") and read("force").endswith("N"))

        page.find_element(By.ID, "start").click()
        wait_for(lambda: "REC" in read("record-state"))
        page.find_element(By.CSS_SELECTOR, "[data-condition=Optimized]").click()
        wait_for(lambda: "marked in the recording" in read("answer"))
        wait_for(lambda: read("condition") == "Optimized")
        time.sleep(1.0)
        page.find_element(By.ID, "stop").click()
        wait_for(lambda: "is written (Optimized)" in read("answer"))
        recorded = read_log(out / "unbraced_1.mcap")
        assert [mark.text for mark in recorded.marks if mark.kind == "condition"] == ["Unbraced", "Optimized"]
        assert (out / "unbraced_1.c3d").is_file()
        wait_for(lambda: page.find_element(By.CSS_SELECTOR, "tr.now").text.split()[:2] == ["Optimized", "1"])

        assert_red_within_a_second(page, mock.process)
        assert "LOST" in page.find_element(By.CSS_SELECTOR, ".device b").text
        faults = [entry for entry in page.get_log("browser") if entry["level"] == "SEVERE"]
        assert faults == []


def drawn(page) -> str:
    """The picture of the knee's curves."""
    return page.execute_script("return document.getElementById('knee-plot').toDataURL()")


def assert_red_within_a_second(page, process) -> None:
    """The page's own clock tells how long after the mock's death its tile turned red."""
    page.execute_script("""
        window.redAt = 0;
        const look = () => {
          const tile = document.querySelector('.device');
          if (getComputedStyle(tile).backgroundColor === 'rgb(214, 38, 43)') window.redAt = Date.now();
          else requestAnimationFrame(look);
        };
        look();
    """)
    assert page.execute_script("return window.redAt") == 0
    killed = 1000 * time.time()
    process.kill()
    wait_for(lambda: page.execute_script("return window.redAt") > 0)
    assert page.execute_script("return window.redAt") - killed < 1000


@needs_browser
@pytest.mark.slow
def test_a_page_whose_program_is_gone_says_so(tmp_path):
    lab = tmp_path / "lab.toml"
    lab.write_text(LAB.format(standing=""))
    with (
        live(lab, tmp_path / "out", "--device", "vicon://127.0.0.1:9") as (process, url),
        browser(tmp_path / "profile") as page,
    ):
        from selenium.webdriver.common.by import By

        page.get(url)
        wait_for(lambda: page.find_elements(By.CSS_SELECTOR, ".device"))
        assert page.find_element(By.CSS_SELECTOR, ".device").get_attribute("class") == "device waiting"
        process.kill()
        wait_for(lambda: "No connection" in page.find_element(By.ID, "banner").text)
        assert page.find_element(By.CSS_SELECTOR, ".device").get_attribute("class") == "device lost"
