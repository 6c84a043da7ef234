"""What the image is made of: nothing that is not there, no root, no version left open."""

import re
import subprocess
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[1]
LINES = (ROOT / "Dockerfile").read_text().splitlines()
STEPS = ROOT / "scripts/image_steps.sh"


def test_what_is_copied_is_there():
    copied = [word for line in LINES if line.startswith("COPY") and "--from" not in line for word in line.split()[1:-1]]
    assert copied
    assert all((ROOT / name).exists() for name in copied)


def test_bases_are_pinned_and_the_user_is_nobody_special():
    bases = [line.split()[1] for line in LINES if line.startswith("FROM")]
    assert all(re.fullmatch(r"python:3\.11\.\d+-slim-\w+", base) for base in bases)
    users = [line.split()[1] for line in LINES if line.startswith("USER")]
    assert users == ["haustra"]
    assert max(k for k, line in enumerate(LINES) if line.startswith("USER")) < LINES.index(
        'ENTRYPOINT ["sh", "/setup/image_steps.sh", "run"]'
    )


def test_every_step_that_the_image_takes_is_one_of_the_scripts():
    taken = set(
        re.findall(
            r'image_steps\.sh"?,? "?(\w+)', "\n".join(line for line in LINES if line.startswith(("RUN", "ENTRY")))
        )
    )
    known = set(re.findall(r"^(\w+)\)$", STEPS.read_text(), re.MULTILINE))
    assert taken == {"wheel", "install", "run"} == known


def test_an_unknown_step_is_refused():
    done = subprocess.run(["sh", str(STEPS), "fly"], capture_output=True, text=True)
    assert done.returncode == 2
    assert "a step is" in done.stderr


def test_the_scripts_are_sound_shell():
    for name in ("image_steps.sh", "check_image.sh"):
        assert subprocess.run(["sh", "-n", str(ROOT / "scripts" / name)]).returncode == 0


def test_the_services_have_no_network_and_no_rights():
    services = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]
    for service in services.values():
        assert service["network_mode"] == "none"
        assert service["read_only"]
        assert service["cap_drop"] == ["ALL"]


def test_the_citation_is_of_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    (version,) = re.findall(r'^version = "(.*)"', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    assert str(citation["version"]) == version
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
