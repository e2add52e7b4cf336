"""Registries: what is chosen by name comes from the package and from extensions, and a bad extension breaks nothing else."""

from __future__ import annotations

import sys
from collections.abc import Callable

import pytest

from cabinpose.core.errors import ConfigError, ExtensionError
from cabinpose.core.registry import OURS, Registry, one_of

Install = Callable[..., None]  # see the fixture `extension`


class Base:
    """What the things of these tests derive from."""


def of_classes(group: str = "cabinpose.tries") -> Registry[type[Base]]:
    return Registry(group, "try", Base, subclass=True)


CODE = "from test_registry_base import Base\nclass One(Base): ...\nclass Two(Base): ...\nTABLE = {'three': One}\n"


@pytest.fixture(autouse=True)
def base(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "test_registry_base", sys.modules[__name__])


def test_things_are_listed_without_being_imported(extension: Install) -> None:
    extension("acme", {"tries": {"one": "One", "two": "Two", "three": "TABLE"}}, CODE)
    found = of_classes()
    assert found.names() == ("one", "three", "two")
    assert found.names(own=True) == ()
    assert "one" in found
    assert one_of(found, "one") == "one"
    assert found.package("one") == "acme"
    assert "acme" not in sys.modules
    assert found["one"].__name__ == "One"
    assert found["three"] is found["one"]  # of a table
    assert [name for name, _ in found.items()] == ["one", "three", "two"]


def test_a_name_that_does_not_exist(extension: Install) -> None:
    extension("acme", {"tries": {"one": "One"}}, CODE)
    with pytest.raises(ConfigError, match="unknown try 'four'") as caught:
        of_classes()["four"]
    assert caught.value.hint == "known: one"
    with pytest.raises(ValueError, match="unknown try 'four'; known: one"):
        one_of(of_classes(), "four")


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("raise RuntimeError('no licence')", "cannot be loaded: RuntimeError: no licence"),
        ("import no_such_library", "No module named 'no_such_library'"),
        ("class One: ...", "is not a Base"),
        ("", "has no attribute 'One'"),
    ],
)
def test_an_extension_that_cannot_be_loaded_is_named_and_left_out(extension: Install, code: str, words: str) -> None:
    extension("broken", {"tries": {"one": "One"}}, code)
    extension("whole", {"tries": {"two": "Two"}}, CODE)
    found = of_classes()
    with pytest.raises(ExtensionError, match="the try 'one' of broken") as caught:
        found["one"]
    assert words in str(caught.value)
    assert caught.value.hint == "update or uninstall broken; everything else works without it"
    with pytest.warns(UserWarning, match="of broken .* it is left out"):
        assert [name for name, _ in found.items()] == ["two"]


def test_an_extension_for_another_version(extension: Install) -> None:
    extension("old", {"tries": {"one": "One"}}, CODE, requires=["cabinpose<0.1", "numpy"])
    with pytest.raises(ExtensionError, match=r"old is built for cabinpose <0\.1; this is"):
        of_classes()["one"]


def test_a_name_that_two_packages_use_is_of_neither(extension: Install) -> None:
    extension("acme", {"tries": {"one": "One"}}, CODE)
    extension("other", {"tries": {"one": "One"}}, CODE)
    found = of_classes()
    assert found.conflicts() == ("the try 'one' is left out: acme, other all have one of this name",)
    with pytest.raises(ExtensionError, match="acme, other"):
        found["one"]


def test_nothing_that_was_loaded_hides_what_is_installed_now(extension: Install) -> None:
    extension("acme", {"tries": {"one": "One"}}, CODE)
    found = of_classes()
    assert found["one"].__module__ == "acme"
    extension("other", {"tries": {"one": "One"}}, CODE)
    with pytest.raises(ExtensionError, match="acme, other all have one of this name"):
        found["one"]


def test_a_name_of_ours_stays_ours(extension: Install) -> None:
    extension("acme", {"sources": {"replay": "One"}}, CODE)
    found: Registry[type[object]] = Registry("cabinpose.sources", "kind of source", object, subclass=True)
    assert found.package("replay") == OURS
    with pytest.warns(UserWarning, match="the kind of source 'replay' of acme is left out: cabinpose has one of this name"):
        assert found["replay"].__module__ == "cabinpose.record.sources.replay"


OUTLINED = """
class One(Base):
    '''The first.

    More.
    '''

    def work(self): ...

UNIT = One()
MADE = build()
"""


def test_a_class_is_outlined_without_being_imported(extension: Install) -> None:
    extension("acme", {"tries": {"one": "One", "unit": "UNIT", "made": "MADE"}}, OUTLINED)
    found = of_classes()
    for name in ("one", "unit"):
        assert found.outline(name) == ("The first.", ("Base",), {"work"})
    assert found.outline("made") is None
    assert "acme" not in sys.modules
    with pytest.raises(ConfigError, match="unknown try 'four'"):
        found.outline("four")
