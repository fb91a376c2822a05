"""Files of a folder by their names, whatever the case of the letters: folders wander between systems that tell
`Mask.PNG` from `mask.png` and systems that do not."""

from pathlib import Path


class FolderFiles:
    """The files in a folder, those in folders within left out."""

    def __init__(self, folder: Path):
        self._exact = {path.name: path for path in sorted(folder.iterdir()) if path.is_file()}
        self._folded: dict[str, list[Path]] = {}
        for path in self._exact.values():
            self._folded.setdefault(path.name.casefold(), []).append(path)

    def get(self, name: str) -> Path | None:
        """The file of this name; where there is none, the only one whose name differs in case alone. Else None."""
        if name in self._exact:
            return self._exact[name]
        alike = self._folded.get(name.casefold(), [])
        return alike[0] if len(alike) == 1 else None

    def ending(self, *suffixes: str) -> list[Path]:
        """Files with one of these suffixes (lower case, with the dot), in the order of names; no hidden ones."""
        paths = self._exact.values()
        return [path for path in paths if path.suffix.lower() in suffixes and not path.name.startswith(".")]
