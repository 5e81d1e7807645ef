"""Components: which files each component under test is made of, and how many."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any, TypeVar

from pytest_dura.evidence.conclusions.conclusion import Conclusion
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import RecordHead
from pytest_dura.evidence.redaction import holds_redaction
from pytest_dura.evidence.session_model import ComponentEntry, ComponentUnderTest
from pytest_dura.provenance import digest_of

_Component = TypeVar("_Component", ComponentEntry, ComponentUnderTest)


class Components(Conclusion):
    """Concludes files and their number in the key ``component_under_test``."""

    def add(self, episode: EpisodeEntry) -> None:
        """Take no episode in: it names its component, which the head describes."""

    def concluded(self, head: RecordHead) -> Mapping[str, Any]:
        """Count the files of each digest, and leave out those of no component."""
        first, sources = head.component_under_test, head.component_under_test.sources
        if sources is None:
            return {}
        used = {component.digest for component in head.components()}
        counted = self._counted(first, sources)
        if first.others is not None:
            others = [self._counted(other, sources) for other in first.others]
            counted = counted.replace(others=others)
        kept = {digest: files for digest, files in sources.items() if digest in used}
        return {"component_under_test": counted.replace(sources=kept or None)}

    @staticmethod
    def _counted(component: _Component, sources: Mapping[str, Mapping[str, str]]) -> _Component:
        files = sources.get(component.digest or "")
        return component if files is None else component.replace(file_count=len(files))

    def check(self, episode: EpisodeEntry) -> Iterator[str]:
        """Yield that an episode is of no component that the head describes."""
        if episode.component not in self._described:
            yield f"component_under_test: {episode.component} is not described"

    @cached_property
    def _described(self) -> set[str | None]:
        return {component.name for component in self.head.components()} | {"none"}

    def check_head(self) -> Iterator[str]:
        """Compare digests with those of files, and files with the inputs of the session."""
        hashed = {(file.path, file.sha256) for file in self.head.inputs}
        sources = self.head.component_under_test.sources or {}
        for component in self.head.components():
            for file in component.files or ():
                if (file.path, file.sha256) not in hashed:
                    yield f"inputs: {file.path} of the component is not among them"
            name, digest = f"component {component.name}", component.digest
            if digest is None:
                continue
            named = sources.get(digest)
            if named is None:
                yield f"{name}: no files are listed of which its digest could be made"
                continue
            # Without the name that was a secret it cannot be made again.
            if not holds_redaction(list(named)) and digest_of(named) != digest:
                yield f"{name}: its digest is not that of its files"
            for file in component.files or ():
                if file.sha256 not in named.values():
                    yield f"{name}: {file.path} is none of the files that its digest is made of"
