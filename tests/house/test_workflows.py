"""The public repository's workflows and forms: their syntax, and that they run what is run here."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import yaml

pytest.importorskip("check_jsonschema", reason="needs the development tools")
ROOT = Path(__file__).parents[2]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))


def _checked(schema: str, *files: Path) -> tuple[int, str]:
    """Exit code and words of the tool that knows the schemas."""
    from check_jsonschema import main
    from click.testing import CliRunner

    done = CliRunner().invoke(main, ["--builtin-schema", f"vendor.{schema}", *map(str, files)])
    return done.exit_code, done.output


@pytest.mark.parametrize(("schema", "files"), [("github-workflows", WORKFLOWS), ("github-issue-forms", FORMS)])
def test_syntax(schema: str, files: list[Path]) -> None:
    assert files
    assert _checked(schema, *files) == (0, "ok -- validation done\n")


def test_wrong_syntax_is_found(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.yml"
    wrong.write_text(WORKFLOWS[0].read_text("utf-8").replace("runs-on:", "runs_on:"), encoding="utf-8")
    assert "'runs-on' is a required property" in _checked("github-workflows", wrong)[1]


def test_workflows_call_the_makefile() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    for path in WORKFLOWS:
        for job in yaml.safe_load(path.read_text("utf-8"))["jobs"].values():
            for line in (step["run"] for step in job["steps"] if "run" in step):
                called = re.fullmatch(r"make ([a-z-]+) PYTHON=python", line)
                assert called is not None, f"{path.name}: {line}"
                assert called[1] in targets, f"{path.name}: {line}"


def test_every_python_that_is_promised_is_tried() -> None:
    classifiers = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["classifiers"]
    promised = re.findall(r"Python :: (3\.\d+)", "\n".join(classifiers))
    tests = yaml.safe_load((ROOT / ".github" / "workflows" / "tests.yml").read_text("utf-8"))["jobs"]["tests"]
    assert tests["strategy"]["matrix"]["python"] == promised


def test_the_lock_without_cuda_is_the_other_without_its_libraries() -> None:
    whole, without = ((ROOT / f"requirements-{name}.lock").read_text("utf-8").splitlines() for name in ("train", "train-cpu"))
    gone = [line for line in whole if line not in without]
    assert [line for line in whole if line in without] == without
    assert any(line.startswith("torch==") for line in without)
    assert all(line.startswith(("nvidia-", "cuda-", "triton==")) for line in gone)
    assert not [line for line in without if "nvidia" in line or "cuda" in line]
