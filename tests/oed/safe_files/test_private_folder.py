"""Where no other user can put a file: the folder, those above it, and links."""

import os
from pathlib import Path

import pytest

from oed import safe_files
from oed.safe_files import is_private, make_private

pytestmark = pytest.mark.skipif(
    os.name != "posix", reason="Windows has other permissions"
)
OTHER = 12345


def test_a_folder_and_all_that_are_made_above_it_are_the_user_s(tmp_path):
    earlier = os.umask(0)
    try:
        assert make_private(tmp_path / "a" / "b" / "c")
    finally:
        os.umask(earlier)
    for folder in ("a", "a/b", "a/b/c"):
        assert (tmp_path / folder).stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("mode", [0o757, 0o722, 0o702])
@pytest.mark.parametrize("depth", [0, 1, 2])
def test_who_can_write_above_a_folder_can_replace_it(tmp_path, mode, depth):
    folder = tmp_path / "a" / "b" / "c"
    assert make_private(folder)
    (folder, *folder.parents)[depth].chmod(mode)
    assert not make_private(folder)
    assert not is_private(folder)


def test_a_folder_like_tmp_may_lie_above(tmp_path):
    """Everybody writes there, and nobody replaces another's folder."""
    tmp_path.chmod(0o1777)
    assert make_private(tmp_path / "mine")


def test_the_group_of_this_user_alone_may_write(tmp_path, monkeypatch):
    folder = tmp_path / "a" / "b"
    assert make_private(folder)
    folder.parent.chmod(0o775)
    monkeypatch.setattr(safe_files, "_is_own_group", lambda number: False)
    assert not is_private(folder)
    monkeypatch.setattr(safe_files, "_is_own_group", lambda number: True)
    assert is_private(folder)


def test_a_link_leads_nowhere(tmp_path, monkeypatch):
    """But one of the administrator, who is none of the users here."""
    made = tmp_path / "elsewhere" / "compiled"
    assert make_private(made)
    (tmp_path / "cache").symlink_to(made.parent)
    linked = tmp_path / "cache" / "compiled"
    monkeypatch.setattr(safe_files, "ROOT_USER", OTHER)
    monkeypatch.setattr(Path, "lstat", owned_by_this_user(tmp_path))
    assert is_private(made)
    assert not is_private(linked)
    assert not is_private(tmp_path / "cache")
    monkeypatch.setattr(safe_files, "ROOT_USER", os.getuid())
    assert is_private(linked)


def owned_by_this_user(below: Path):
    """`lstat` with every folder above `below` owned by this user, as at his home."""
    lstat = Path.lstat

    def owned(path: Path) -> os.stat_result:
        status = lstat(path)
        if path == below or below.is_relative_to(path):
            return os.stat_result((0o40700, 0, 0, 2, os.getuid(), 0, 0, 0, 0, 0))
        return status

    return owned


def test_another_user_s_folder_is_not_private(tmp_path, monkeypatch):
    assert make_private(tmp_path / "a")
    monkeypatch.setattr(os, "getuid", lambda: OTHER)
    assert not is_private(tmp_path / "a")
