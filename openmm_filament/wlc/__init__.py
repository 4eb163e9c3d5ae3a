"""Theory of the worm-like chain under a force, and of the simpler chains it is compared with. Loads no openmm.

Units: forces in pN, lengths in nm, energies and `kT` in pN nm, stretch modulus in pN; a bond's stretching stiffness in
pN/nm, a joint's bending stiffness in pN nm (per rad^2), angles in rad. `bending_over_kT` and cosines are pure numbers.

Conventions: `persistence_length` is `l_p = A/kT` with A the bending rigidity, in both dimensions, so the tangent
correlation is `exp(-s/l_p)` in three dimensions and `exp(-s/(2 l_p))` in two. `f = F l_p/kT` is the reduced force and d
the dimension. The extension z is the mean end-to-end vector along the force. An `extension_...` or `force_...`
without `dimension` is for three dimensions.

What the functions of the continuous and the flexible chains share; for discrete chains see `extension_discrete`:

Parameters
----------
force : array_like
    F >= 0 in pN, scalar or array.
extension : array_like
    z >= 0 in nm, scalar or array; `force_...` is the inverse of its `extension_...` and names the interval it takes.
persistence_length : float
    l_p in nm; for a flexible chain that of the worm-like chain with the same `<R^2>`.
contour_length : float
    L in nm, without load.
kT : float
    Thermal energy in pN nm.
stretch_modulus : float
    S in pN.
dimension : int
    2 or 3.

Returns
-------
float or ndarray
    The extension in nm or the force in pN, shaped like the first argument.

Raises
------
ValueError
    If an argument is out of its range, or the extension out of the chain's reach.
"""

from openmm_filament.wlc.bonds import bond_length_variance, mean_bond_length, rest_length
from openmm_filament.wlc.continuous import extension_exact, force_exact
from openmm_filament.wlc.discrete import extension_discrete, force_discrete
from openmm_filament.wlc.flexible import extension_fjc, extension_gaussian, force_fjc, force_gaussian
from openmm_filament.wlc.interpolations import (
    extension_bouchiat,
    extension_marko_siggia,
    force_bouchiat,
    force_marko_siggia,
)
from openmm_filament.wlc.joints import bending_from_cosine, mean_cosine
from openmm_filament.wlc.limits import (
    extension_high_force,
    extension_hookean,
    extension_odijk,
    force_high_force,
    force_hookean,
    force_odijk,
)
from openmm_filament.wlc.moments import (
    mean_squared_end_to_end,
    mean_squared_end_to_end_discrete,
    mean_squared_radius_of_gyration,
    mean_squared_radius_of_gyration_discrete,
    mean_squared_sizes,
)
from openmm_filament.wlc.tangents import tangent_correlation_discrete

__all__ = [
    "bending_from_cosine",
    "bond_length_variance",
    "extension_bouchiat",
    "extension_discrete",
    "extension_exact",
    "extension_fjc",
    "extension_gaussian",
    "extension_high_force",
    "extension_hookean",
    "extension_marko_siggia",
    "extension_odijk",
    "force_bouchiat",
    "force_discrete",
    "force_exact",
    "force_fjc",
    "force_gaussian",
    "force_high_force",
    "force_hookean",
    "force_marko_siggia",
    "force_odijk",
    "mean_bond_length",
    "mean_cosine",
    "mean_squared_end_to_end",
    "mean_squared_end_to_end_discrete",
    "mean_squared_radius_of_gyration",
    "mean_squared_radius_of_gyration_discrete",
    "mean_squared_sizes",
    "rest_length",
    "tangent_correlation_discrete",
]
