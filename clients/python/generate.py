"""Generates the messages and the stubs of the calls from `proto/` when a wheel is built."""

import shutil
import tempfile
from pathlib import Path
from typing import Any

from grpc_tools import protoc
from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class GenerateHook(BuildHookInterface[Any]):
    """Adds what protoc generates to the wheel; the source folder stays as it is."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Runs protoc on all files of the schema."""
        proto = schema(Path(self.root))
        self.folder = Path(tempfile.mkdtemp(prefix="graphfix-"))
        arguments = ["protoc", f"--proto_path={proto}", f"--proto_path={included()}"]
        arguments += [f"--{kind}_out={self.folder}" for kind in ("python", "pyi", "grpc_python")]
        names = [str(path.relative_to(proto)) for path in sorted(proto.rglob("*.proto"))]
        if protoc.main(arguments + names) != 0:
            raise RuntimeError("protoc refuses the schema")
        kind = "force_include_editable" if version == "editable" else "force_include"
        for path in self.folder.rglob("*.py*"):
            build_data[kind][str(path)] = str(path.relative_to(self.folder))

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Removes the generated files."""
        shutil.rmtree(self.folder)


def schema(root: Path) -> Path:
    """The folder of the schema: beside the sources of a distribution, or in the repository."""
    for folder in (root / "proto", root.parent.parent / "proto"):
        if (folder / "graphfix").is_dir():
            return folder
    raise FileNotFoundError(f"no folder proto/ beside {root} or above")


def included() -> Path:
    """The folder of Google's own schema files, which grpcio-tools brings."""
    return Path(protoc.__file__).parent / "_proto"
