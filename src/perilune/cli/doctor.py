"""The command ``doctor``: versions, optional parts, whether arcs run as machine code, and its cache on disk."""

from __future__ import annotations

from typing import Any

from perilune.cli.output import CommandAnswer

# What `pip install 'perilune[PART]'` brings: the modules without which that part says it is missing.
PARTS = {
    "msis": ("pymsis",),
    "cluster": ("distributed",),
    "export": ("pandas", "pyarrow", "xarray"),
    "explore": ("starlette", "uvicorn", "websockets"),
    "rigorous": ("flint",),
}


def diagnosis(clear_cache: bool) -> CommandAnswer:
    """Examine the installation, after removing the machine code kept on disk if that is wanted."""
    import platform
    from importlib.util import find_spec

    from perilune.io import program_versions
    from perilune.kernels import clear_cache as clear, report_cache

    removed = clear() if clear_cache else None
    kept, compiles = report_cache(), find_spec("llvmlite") is not None
    parts = {part: all(map(find_spec, modules)) for part, modules in PARTS.items()}
    document: dict[str, Any] = {
        "versions": program_versions(),
        "platform": f"{platform.system()} {platform.machine()}",
        "parts": parts,
        "machine_code": compiles,
        "cache": {
            "path": None if kept.path is None else str(kept.path),
            "files": kept.files,
            "bytes": kept.size,
            "usable": kept.usable,
        },
    }
    lines = [f"{name:10} {version}" for name, version in document["versions"].items()]
    lines += [f"{'platform':10} {document['platform']}"]
    lines += [f"{'parts':10} " + ", ".join(f"{part}: {'yes' if there else 'no'}" for part, there in parts.items())]
    if not all(parts.values()):
        lines += [f"  add one: pip install 'perilune[{min(parts, key=parts.__getitem__)}]'"]
    lines += ["machine code for arcs: " + ("yes" if compiles else "no, llvmlite is not installed: slower")]
    lines += ["machine code on disk: " + _cache_text(kept)]
    if removed is not None:
        document["cache"]["removed"] = removed
        lines += [f"  {removed} files removed"]
    elif kept.files:
        lines += ["  remove it: perilune doctor --clear-cache"]
    return CommandAnswer(text="\n".join(lines), document=document)


def _cache_text(kept: Any) -> str:
    if kept.path is None:
        return "none is stored: PERILUNE_CACHE is off, or there is no home directory"
    text = f"{kept.files} files, {kept.size / 1e6:.1f} MB, in {kept.path}"
    return text if kept.usable else f"{text}, which cannot be used: other users may write there, or you may not"
