"""What was traced is kept where the platform keeps such things, or nowhere."""

from pathlib import Path

import bpy
import pytest
from prt_baker.addon import cache_folder, properties


def test_it_is_in_the_users_cache_and_there(scene, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "deep" / "cache"))
    found = cache_folder.path()
    assert found == str(tmp_path / "deep" / "cache" / "prt-baker")
    assert Path(found).is_dir()
    assert properties.settings(scene).cache == found


@pytest.mark.parametrize("given", [None, "", "not/absolute"])
def test_without_a_word_about_it_it_is_in_the_home(monkeypatch, tmp_path, given):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    if given is not None:
        monkeypatch.setenv("XDG_CACHE_HOME", given)
    assert cache_folder.path() == str(tmp_path / ".cache" / "prt-baker")


@pytest.mark.parametrize(
    ("platform", "variable", "place"),
    [("darwin", "HOME", "Library/Caches"), ("win32", "LOCALAPPDATA", "")],
)
def test_other_platforms_have_places_of_their_own(monkeypatch, tmp_path, platform, variable, place):
    monkeypatch.setattr(cache_folder.sys, "platform", platform)
    monkeypatch.setenv(variable, str(tmp_path))
    assert cache_folder.path() == str(tmp_path / place / "prt-baker")


def test_an_installed_extension_keeps_it_in_its_own_folder(monkeypatch, tmp_path):
    asked = []

    def own(package, **options):
        asked.append((package, options))
        return str(tmp_path)

    monkeypatch.setattr(cache_folder, "PACKAGE", "bl_ext.user_default.prt_baker")
    monkeypatch.setattr(bpy.utils, "extension_path_user", own)
    assert cache_folder.path() == str(tmp_path)
    assert asked == [("bl_ext.user_default.prt_baker", {"path": "cache", "create": True})]


def test_where_nothing_can_be_written_nothing_is_kept(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert cache_folder.path() == ""
