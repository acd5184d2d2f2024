"""LU2Net's authors' checkpoints (`.pth`), for whoever has the right to use them: their tensors under our names.

A `.pth` is a zip with a pickle in it, and a pickle can run code. This one cannot: the few callables that it may name
are replaced by functions of this file that describe a tensor, and whatever else it names is refused. Sizes are bounded
before anything is read. Wrappers are looked into: {"state_dict": ...}, and DataParallel's "module." before names.

The names are those of LU2Net.py in the authors' repository (MrYangHaoDong/LU2Net, commit 7190ddc).
"""

from __future__ import annotations

import io
import math
import pickle
import zipfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.config import ConfigError

SUFFIXES = (".pth", ".pt")
MOST_BYTES = 32_000_000  # of the file and of what it unpacks to: weights take 0.7 MB, with an optimiser's state 2.1 MB
MOST_PICKLE = 1_000_000  # bytes; 120 tensors take 20,000

BLOCKS = {
    "conv_in": "first",
    "e1": "encoder1",
    "e3": "encoder2",
    "b5": "middle",
    "d4": "decoder1",
    "d2": "decoder2",
    "conv_out": "last",
}
ENCODER = {"dw": "axial", "bn": "norm", "pw": "widen"}
MIDDLE = {"pw1": "narrow", "dw1": "near", "dw2": "mid", "dw3": "far", "bn": "norm", "pw2": "mix"}
DECODER = {"pw": "merge", "bn": "norm", "dw": "axial", "pw2": "mix"}
LAYERS = {"e1": ENCODER, "e3": ENCODER, "b5": MIDDLE, "d4": DECODER, "d2": DECODER}
AXIAL = {"dw_h": "down", "dw_w": "across", "CAB.conv_du.0": "attention.squeeze", "CAB.conv_du.2": "attention.excite"}

DTYPES = {"FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "LongStorage": "<i8"}
WRAPPERS = ("state_dict", "model_state_dict", "model", "net", "params")

Array = NDArray[Any]
BROKEN = (
    *(pickle.UnpicklingError, zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError, RuntimeError),
    *(KeyError, IndexError, ValueError, TypeError, AttributeError, OverflowError, MemoryError),
)  # what zip and pickle raise for files that are damaged or made to do damage


class Forbidden(pickle.UnpicklingError):
    """The pickle names something that is no tensor."""


class Storage(NamedTuple):
    """A type of numbers, by torch's name for it."""

    dtype: str


class Names(dict[str, Any]):
    """An OrderedDict of the pickle; torch hangs its versions on it as an attribute."""


def is_published(path: Path) -> bool:
    return path.suffix.lower() in SUFFIXES


def read(path: Path) -> dict[str, Array]:
    """A checkpoint's tensors under our names. Raises ConfigError in one line for anything else; nothing is executed."""
    try:
        found = _tensors(path)
    except Forbidden as error:
        raise ConfigError(
            f"{path}: asks for {error}, which is no tensor, and is not run; give a file of tensors alone"
        ) from None
    except BROKEN:
        raise ConfigError(
            f"{path}: not a checkpoint of LU2Net by its authors: damaged, too large, or not written by torch.save"
        ) from None
    named = {ours(name): value for name, value in found.items()}
    return {name: value for name, value in named.items() if name is not None}


def ours(name: str) -> str | None:
    """Our name of a tensor of theirs; None if it is none of theirs."""
    block, _, rest = name.removeprefix("module.").partition(".")
    if block not in BLOCKS:
        return None
    if block not in LAYERS:
        return f"{BLOCKS[block]}.{rest}"
    layer, _, rest = rest.partition(".")
    if layer not in LAYERS[block]:
        return None
    part, _, kind = rest.rpartition(".")
    inner = AXIAL.get(part, part)
    return ".".join(filter(None, (BLOCKS[block], LAYERS[block][layer], inner, kind)))


def _tensors(path: Path) -> dict[str, Array]:
    if path.stat().st_size > MOST_BYTES:
        raise ValueError("too large")
    with zipfile.ZipFile(path) as file:
        if sum(entry.file_size for entry in file.infolist()) > MOST_BYTES:
            raise ValueError("too large")
        head = next((name for name in file.namelist() if name.endswith("data.pkl")), "data.pkl")
        if file.getinfo(head).file_size > MOST_PICKLE:
            raise ValueError("too large")
        entry = cache(lambda key: file.read(f"{head.removesuffix('data.pkl')}data/{key}"))
        held = _Reader(file.read(head), entry).load()
    for wrapper in WRAPPERS:
        if isinstance(held, dict) and isinstance(held.get(wrapper), dict):
            held = held[wrapper]
    found = {n: value for n, value in dict.items(held) if isinstance(n, str) and isinstance(value, np.ndarray)}
    if sum(value.nbytes for value in found.values()) > MOST_BYTES:  # many tensors may lie over one storage
        raise ValueError("too large")
    return found


class _Reader(pickle._Unpickler):
    """Python's own unpickler in Python, for the one in C sets aside as much memory as a file asks for."""

    def __init__(self, data: bytes, entry: Callable[[str], bytes]) -> None:
        super().__init__(io.BytesIO(data))
        self._entry = entry

    def find_class(self, module: str, name: str) -> object:
        if module == "torch" and name in DTYPES:
            return Storage(DTYPES[name])
        known: dict[tuple[str, str], object] = {
            ("collections", "OrderedDict"): Names,
            ("torch._utils", "_rebuild_tensor_v2"): _tensor,
            ("torch._utils", "_rebuild_parameter"): _parameter,
        }
        if (module, name) not in known:
            raise Forbidden(f"{module}.{name}")
        return known[module, name]

    def persistent_load(self, pid: object) -> Array:
        match pid:
            case ("storage", Storage(dtype), str(key), *_):
                return np.frombuffer(self._entry(key), dtype)
        raise pickle.UnpicklingError("no storage")


def _tensor(storage: Array, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: object) -> Array:
    """A tensor laid over a storage; raises ValueError where it would reach beyond."""
    if len(size) != len(stride) or min((offset, *size, *stride)) < 0 or math.prod(size) > storage.size:
        raise ValueError("no tensor")
    if offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True)) >= storage.size:
        raise ValueError("beyond its storage")
    steps = [step * storage.itemsize for step in stride]
    return np.lib.stride_tricks.as_strided(storage[offset:], size, steps)


def _parameter(value: Array, *_: object) -> Array:
    return value
