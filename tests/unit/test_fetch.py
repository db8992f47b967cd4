"""Fetching CMU's files from a stand-in for its server."""

from __future__ import annotations

import functools
import hashlib
import http.server
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from silem.motion import clips
from silem.util import files, paths
from silem.util.errors import SilemError

NAME = "08/08.asf"
CONTENT = b"one\ntwo\n"


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The file as a stand-in for CMU's server serves it; an empty cache."""
    path = tmp_path / "server" / NAME
    files.write_bytes(path, CONTENT.replace(b"\n", b"\r\n"))
    handler = functools.partial(_Quiet, directory=str(tmp_path / "server"))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    monkeypatch.setattr(clips, "URL", f"http://127.0.0.1:{server.server_port}/")
    monkeypatch.setitem(clips.SHA256, NAME, hashlib.sha256(CONTENT).hexdigest())
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    monkeypatch.delenv(clips.ENV, raising=False)
    yield path
    server.shutdown()
    thread.join()
    server.server_close()


def test_a_file_is_downloaded_once_whatever_its_line_ends(served: Path) -> None:
    path = clips.mocap_file(NAME)
    assert path.read_text() == "one\ntwo\n"  # Python reads CR LF as one line end
    served.unlink()
    assert clips.mocap_file(NAME) == path


def test_a_download_of_the_wrong_content_is_not_kept(served: Path) -> None:
    served.write_bytes(b"other\n")
    found = hashlib.sha256(b"other\n").hexdigest()
    with pytest.raises(SilemError) as error:
        clips.mocap_file(NAME)
    message = str(error.value)
    assert found in message and clips.SHA256[NAME] in message
    assert f"{clips.URL}{NAME} is not CMU's" in message
    assert not (paths.data_dir() / "mocap").exists()
    served.write_bytes(CONTENT)
    assert clips.mocap_file(NAME).read_bytes() == CONTENT


def test_no_network_is_one_error_that_says_where_the_file_belongs(
    served: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = paths.data_dir() / "mocap" / NAME
    served.unlink()
    for url in (clips.URL, "http://127.0.0.1:9/"):  # not there; nobody listens
        monkeypatch.setattr(clips, "URL", url)
        with pytest.raises(SilemError, match=f"cannot download {url}{NAME}.* put the file at"):
            clips.mocap_file(NAME)
    assert not place.exists()
    files.write_bytes(place, CONTENT)  # as the error says
    assert clips.mocap_file(NAME) == place


def test_the_users_own_folder_is_read_and_never_changed(
    served: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(clips.ENV, str(tmp_path / "own"))
    with pytest.raises(SilemError, match=f"own/{NAME} is missing; SILEM_MOCAP_DIR must hold it"):
        clips.mocap_file(NAME)
    own = tmp_path / "own" / NAME
    files.write_bytes(own, b"other\n")
    with pytest.raises(SilemError, match=f"expected {clips.SHA256[NAME]}"):
        clips.mocap_file(NAME)
    assert own.read_bytes() == b"other\n"
    files.write_bytes(own, CONTENT)
    assert clips.mocap_file(NAME) == own
    with pytest.raises(SilemError, match=r"unknown motion capture file '08/08_12\.amc'"):
        clips.mocap_file("08/08_12.amc")
