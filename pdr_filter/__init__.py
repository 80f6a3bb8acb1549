"""Pedestrian dead reckoning: estimate a track with its uncertainty from the inertial samples of a phone.

Recordings are read with `read`. `track` gives the online estimate of a whole recording, and `smooth` the best estimate
of a finished walk. An app pushes its samples to an `OnlineFilter`, and adds fixes such as `PositionFix` to it.
`calibrate` estimates the step lengths of people, `fit_contexts` trains a classifier of contexts, and `recipes` are the
configurations (`Config`), in which a `Mode` is one motion model of the interacting multiple model.

Three longer ways begin at these examples: `help(pdr_filter.OnlineFilter)` for a loop with a fix,
`help(pdr_filter.imm)` for an interacting multiple model over own motion models, and `help(pdr_filter.calibrate)` for a
calibration from known distances, or by smoothing from fixes.

The modules are `imm` (the interacting multiple model alone), `evaluate` (measures), `plot`, `simulate`, `datasets`,
`batch` (many recordings), `protocols` (interfaces of own parts) and `testing` (checks of own parts). `dir(pdr_filter)`
lists all names; each has its own help, such as `help(pdr_filter.track)`.
"""

import lazy_loader

from pdr_filter.version import __version__ as __version__

# Each name in `__init__.pyi` is loaded at its first use, so that importing the package is fast.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
