"""A certificate in the place of another, as a person renews it: both files are new from one moment to the next."""

from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory

from agent.core.config import Fleet
from agent.process.certificates import authority, hosts, issue, write


def replace_certificate(fleet: Fleet, keys: Path, name: str, ends: datetime) -> None:
    """By the authority in the same folder. A dialler that reads between the two files tries again."""
    with TemporaryDirectory(dir=keys) as new:
        for file in write(Path(new), name, issue(authority(keys), name, hosts(fleet, name), ends=ends)):
            file.replace(keys / file.name)
