"""Error for a missing optional package (extra of Cardan)."""

from __future__ import annotations

from cardan.common.resource_errors import shortage
from cardan.errors import ExtraImportError


def missing_extra(purpose: str, package: str, extra: str, error: Exception) -> Exception:
    """Return the error to raise if `purpose` needs a `package` that the extra ``cardan[EXTRA]``
    installs, and importing it raised `error`; after a shortage, such as of memory, `error` itself.
    """
    if shortage(error):
        return error
    return ExtraImportError(purpose, package, extra, str(error))
