"""sitecustomize of the environment of tools/lerobot.

The torchvision of package registries is built for PyTorch with CUDA. With a PyTorch without CUDA
its compiled operators cannot be loaded, and its import fails when it registers their shapes. The
tests here do not call the operators: once these are declared, the rest of torchvision works.
"""

import importlib.abc
import importlib.util
import sys

OPERATORS = "nms", "qnms"


class _Declared(importlib.abc.MetaPathFinder):
    """Import hook that declares the operators before torchvision registers them."""

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
