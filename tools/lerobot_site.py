"""sitecustomize of the environment of tools/lerobot.

The torchvision that package registries have is built for PyTorch with CUDA. Beside one without, its
compiled operators cannot be loaded, and its import fails as it describes them to PyTorch. Nothing
that is tested here calls them: they are declared, and the rest of torchvision works.
"""

import importlib.abc
import importlib.util
import sys

OPERATORS = "nms", "qnms"


class _Declared(importlib.abc.MetaPathFinder):
    """Declares them before they are described."""

    def find_spec(self, fullname, path=None, target=None):
        if fullname == "torchvision._meta_registrations":
            sys.meta_path.remove(self)
            import torch

            self.library = torch.library.Library("torchvision", "FRAGMENT")
            for each in OPERATORS:
                if not hasattr(torch.ops.torchvision, each):
                    self.library.define(f"{each}(Tensor x) -> Tensor")
            _INSTANCES.append(self)
        return


_INSTANCES = []
sys.meta_path.insert(0, _Declared())
