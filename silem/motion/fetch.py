"""The raw files of the CMU Graphics Lab Motion Capture Database, fetched when first needed.

Only `silem.motion.clips` needs them, to compute anew what is committed in data/demonstrations.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from silem.util import paths
from silem.util.errors import SilemError, choose

URL = "http://mocap.cs.cmu.edu/subjects/"
ENV = "SILEM_MOCAP_DIR"
"""Environment variable: a folder that holds the files already, as 08/08.asf, 08/08_01.amc, ..."""

SHA256 = {
    "08/08.asf": "b4e0a77603de53d276e0cc564810e83b43df2b79e2f6abac43195aad5b6d7c76",
    "08/08_01.amc": "08345dab7d5d0b1be323ed7f016ae78a1cbf980129a013812afcd8639074513e",
    "08/08_02.amc": "d318b2a66b9f7cf69099d6d10dc2a83817fbc9059d76b6ba9c6cfaad50fd16d1",
    "08/08_03.amc": "dc0f3790c96b704bf5c0ec18e4ead1f2b3e3903e78aa31b3da3be5087a8dab16",
    "08/08_04.amc": "29d629f9d7b97675bbf99403461321c1d1326db52bff40a63aaf7bb9102d3702",
    "08/08_05.amc": "d7488ac9be4717d913f21ce008359dd9f2e6cb91b478e957e06f2aec13c8104b",
    "08/08_06.amc": "1749b0ca0b5e55e3dcaa73358a096dc23aa1769b7f1ddaa15c312e4c5b1544cb",
    "08/08_07.amc": "fdf976cb96d89eb7dc8a6aad65aaa467cce9bb2ec6beeb738c11d23931f25812",
    "08/08_08.amc": "08efebec89f9eb10d8d821a182715cc341b629300764894efc40f0093691933f",
    "08/08_09.amc": "7a0f788e8a86a7fe0c7e710a374d3f9ed8ab5e673b512ebec6bc6a5e87a5a525",
    "08/08_10.amc": "9e181a77c215f83f184d1fe81ecbcd77c50e4875c5dbfd7e61ff2b4581b96cca",
    "08/08_11.amc": "de1a5a81b718d201261e592588ee2660676714154e0d15236a1d8079c5080038",
}
"""SHA-256 of each file with LF line ends; the server's own line ends may be CR LF."""

LICENCE = "free for all uses"
ACKNOWLEDGEMENT = (
    "The data used in this project was obtained from mocap.cs.cmu.edu. "
    "The database was created with funding from NSF EIA-0196217."
)
"""What CMU asks to be said wherever its data are used."""

FOLDER = "mocap"  # of the data folder; git ignores it
_ASIDE = ".mismatch"


def mocap_file(name: str) -> Path:
    """Return a file of the database: from ``$SILEM_MOCAP_DIR`` if set, else from the own cache.

    What the cache lacks is downloaded from CMU's server. Either way the content is checked.

    Args:
        name: The file, for example "08/08_01.amc".

    Raises:
        SilemError: The name is unknown, the file is not in that folder, it cannot be downloaded,
            or its SHA-256 is not the one expected (a downloaded file is then kept aside, under
            the same name and ".mismatch").
    """
    choose("motion capture file", name, SHA256)
    folder = os.environ.get(ENV)
    if folder:
        path = Path(folder).expanduser() / name
        if not path.is_file():
            raise SilemError(f"{path} is missing; {ENV} must hold it, or be unset to download it")
        _check(path, name)
        return path
    path = paths.data_dir() / FOLDER / name
    if not path.is_file():
        _download(name, path)
    try:
        _check(path, name)
    except SilemError as error:
        aside = path.with_name(path.name + _ASIDE)
        path.replace(aside)
        raise SilemError(f"{error}; it is kept as {aside}") from None
    return path


def _download(name: str, path: Path) -> None:
    import pooch  # it wakes tqdm, whose warning would stand in every notebook

    pooch.get_logger().setLevel("WARNING")  # the hash is checked here, not by pooch
    try:
        pooch.retrieve(URL + name, known_hash=None, fname=path.name, path=path.parent)
    except (OSError, ValueError) as error:  # requests' errors are OSErrors
        raise SilemError(
            f"cannot download {URL}{name} ({type(error).__name__}); with no network, put the file"
            f" at {path} by hand, or set {ENV} to a folder that holds {name}"
        ) from error


def _check(path: Path, name: str) -> None:
    """Compare a file with the one expected, whatever its line ends."""
    content = path.read_bytes().replace(b"\r\n", b"\n")
    found = hashlib.sha256(content).hexdigest()
    if found != SHA256[name]:
        raise SilemError(
            f"{path} is not CMU's {name} (SHA-256 with LF line ends): found {found},"
            f" expected {SHA256[name]}"
        )
