"""Imports the package `mirrorball` from the sources that the executable carries."""

import importlib.abc
import importlib.machinery
import importlib.util
import types
from collections.abc import Sequence


class Carried(importlib.abc.MetaPathFinder, importlib.abc.InspectLoader):
    """Finds modules by name in a dictionary of (source, is package)."""

    def __init__(self, sources: dict[str, tuple[str, bool]]) -> None:
        self.sources = sources

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: types.ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Tell Python where the module comes from, or nothing if it is not ours."""
        if fullname not in self.sources:
            return None
        return importlib.util.spec_from_loader(fullname, self, origin=self.origin(fullname))

    def origin(self, fullname: str) -> str:
        """Name the file as tracebacks show it."""
        return f"<mirrorball>/{fullname.replace('.', '/')}.py"

    def is_package(self, fullname: str) -> bool:
        """Say whether it has modules below it."""
        return self.sources[fullname][1]

    def get_source(self, fullname: str) -> str:
        """Give the text, for tracebacks too."""
        return self.sources[fullname][0]

    def get_code(self, fullname: str) -> types.CodeType:
        """Compile the text under its own name."""
        return compile(self.get_source(fullname), self.origin(fullname), "exec", dont_inherit=True)
