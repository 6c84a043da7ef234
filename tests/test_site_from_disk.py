"""The site as it is opened from the disk, without a network: it fetches nothing, and its search finds pages."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.showing.chromium import CHROMIUM, FLAGS, PATIENCE_MS, complaints, until

ROOT = Path(__file__).parents[1]
pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install chromium")]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    subprocess.run(command, cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, check=True)
    return folder


def test_pages_search_and_diagram_need_no_network(site: Path) -> None:
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
    fetched: list[str] = []
    said: list[str] = []
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        page = browser.new_context(offline=True).new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.on("request", lambda request: fetched.append(request.url))
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto((site / "project/architecture.html").as_uri())
        assert "loop_closing" in page.inner_text("article pre")
        page.goto((site / "guide/long_videos.html").as_uri())
        page.click("input.md-search__input")
        page.keyboard.type("interlaced")
        links = page.locator(".md-search-result__link")
        until(page, lambda: links.count() > 0)
        assert any("first_video.html" in (link.get_attribute("href") or "") for link in links.all())
        browser.close()
    assert [url for url in fetched if not url.startswith(("file:", "data:", "blob:"))] == []
    assert complaints(said) == []
