"""Every tolerance of the tests, with what was measured beside it (double precision, OpenMM 8.6.1, Reference)."""

OPENMM_FORCES = 1e-10
"""OpenMM against NumPy forces, largest error over largest force of a chain. Measured on 1000 random chains a term:
at most 6e-14 where no bend is small; 1e-12 in one chain whose smallest bend is a few mrad (OpenMM's acos)."""
OPENMM_ENERGIES = 1e-10
"""The same for energies, relative to the sum of their magnitudes over the chains. Measured: at most 5e-15."""
MILLIRADIAN = 1e-8
"""The same for forces where every bend is 1 mrad: acos there keeps ten digits. Measured: 1.1e-10."""
CENTRAL_DIFFERENCE = 5e-8
"""Forces against fourth-order differences with a step of 1e-4 nm. Measured: 2e-10 or less but for one chain of 4.5e-9,
whose nearly straight beads make the fifth derivative of a dihedral large."""
NET = 1e-13
"""Net force over the sum of the magnitudes, and net torque likewise with a lever. Measured: at most 9e-16."""
MOVED = 5e-12
"""Energies and forces of a rotated and shifted chain. Measured: 1.4e-13 (the shift rounds the coordinates)."""
AT_REST = 1e-13
"""Energy and force of a chain at rest over those at random positions. Measured: at most 9e-15 (OpenMM's acos)."""
HIGH_PRECISION = 1e-9
"""NumPy forces against 50 digits. Measured: 6e-11 at a bend of 1e-6 rad (segments are differences of doubles), falling
in proportion to the bend; 3e-14 at pi - 1e-3."""
ARCTANGENT = 1e-14
"""OpenMM's bending forces in the form "arctangent" against 50 digits, times the sine of the bend, from 1e-10 to pi - 1e-6
rad: rounding of coordinates. Measured: at most 5e-16."""
STRAIGHT = 1e-15
"""Force of a straight chain in the form "arctangent" over its bending stiffness over 1 nm: the sine of 1e-15 that stands
for zero, times the rest angle. Measured: 2e-17."""
THESIS = 1e-10
"""Our forces against the thesis's term by term, for bends and torsions at least 0.1 from 0 and pi. Measured: 4e-15."""
CONSTANT = 1e-9
"""Constants of nature against scipy, whose release may hold CODATA 2018 or 2022: eps0 differs by 7e-10."""
ROUNDING = 1e-12
"""A handful of floating-point operations. Measured: at most 2.1e-14 (the bends of a ring of 60)."""
ANGLE = 1e-10
"""Angles built into a chain and measured again, in rad, 1e-3 from 0 and pi or more. Measured: 1.5e-13 (dihedrals)."""
IMPORT_SECONDS = 0.15
"""What `import openmm_filament` may cost beyond `import openmm` (0.2 to 0.4 s). Measured: 0.00 s (it is lazy)."""
IMPORT_OF_BUILD = 2.0
"""All that `build` needs, openmm and openmm.app among it, over `import openmm`. Measured: 1.3 to 1.5."""
SI = 1e-9
"""Stiffnesses against the closed formula with CODATA numbers: rounding, with room."""
QUADRATURE = 1e-9
"""Averages over one bond or joint against scipy's adaptive quadrature, which is asked for 1e-10."""
LIMIT = 0.05
"""The stability limit against the one found by running: 0.95 of it must hold, 1.05 must not."""
STAYS_SMALL = 1e3
"""Growth of a random push of 1e-7 nm in 2500 Verlet steps below the limit (kept to 1e-3 nm). Measured: at most 12
(a straight free chain, which also turns); beyond the limit infinite."""
LANCZOS = 0.01
"""The limit by Lanczos iterations, stopped at 0.5 % of omega^2, against a dense Hessian. Measured:
2.8e-3 at most, and from above, as it must be."""
EIGENVALUE = 1e-5
"""The limit by a dense Hessian of forward differences of 1e-5 of the shortest segment.
Measured: 4e-8 without charges, whose potential is less harmonic."""
TRAJECTORY = 1e-13
"""Positions, in nm, after 50 Euler-Cromer steps against NumPy; ten times it for velocities and 200 steps.
Measured: 4.4e-16."""
ENERGY_DRIFT = 0.02
"""Spread of the energy of a Verlet run at a tenth of the limit, relative. Measured: at most 0.004 in six runs."""
SIGMAS = 4.0
"""|z| of a seeded average against its exact value: chance exceeds it once in 16,000."""
OPENCL = 1e-5
"""OpenCL in double precision against Reference, relative to the largest force. Measured: 4e-7; parameters of single
elements are kept in single precision there."""
SINGLE = 1.2e-7
"""Coordinates of a DCD, of single precision in Angstrom, relative to the largest. The rounding of two conversions."""
MDTRAJ = 3e-7
"""End-to-end distances by mdtraj, differences of two such coordinates, relative to the largest."""
EQUIPARTITION = 0.1
"""Mean energy of a term over kT/2 an element, 300 starts of a stiff helix. Measured: 0.964 to 1.008."""
SMALL_POPULATION = 0.02
"""Extension of starts of a soft chain with bent joints at 80 pN against the exact one. Measured: 0.010."""
CHI_SQUARED = 1e-3
"""Probability of a sum of squared deviations as large (or as small) as the one found. Seeded: it does not vary."""
HESSIAN = 1e-7
"""The Hessian against central differences of 1e-5 nm of OpenMM's forces, over its largest entry. Measured: at most 2e-9."""
MODES = 1e-8
"""Frequencies of a string by a dense Hessian against the closed form. Measured: at most 7e-11 with 60 segments; rounding
grows with the ratio of the stiffest to the slowest mode squared."""
MODES_LONG = 1e-6
"""The same by iteration with 700 segments, where that ratio is 1e10."""
SMALL_MOTION = 1e-5
"""Frequency of a run of 1e-5 of the string's length in one mode: its stretching shifts it by ES/T (pi n A/L)^2/8 or so, 2e-7
in the lowest mode. Measured: 3.3e-6 in the eighth."""
DAMPED_RUN = 0.01
"""Positions after two periods of a damped run at a tenth of the limit, over the amplitude: Euler-Cromer is of first order in
its phase."""
LINE = 1e-11
"""Place of a single line, in bins, and its decay over the recording. Measured: at most 9e-14 (heights: 3e-12)."""
FIT_SECONDS = 15.0
"""Fit of 40 lines to 20,000 samples. Measured: 0.2 to 0.5 s on one core;
5 s where threads compete for busy cores."""
HEARD = 1e-4
"""Strongest line of a WAV file against that of the motion, in Hz, over 1 or 2 s. Measured: 3e-7."""
SIXTEEN_BITS = 0.7
"""Sample of a WAV file against the motion at its time, in steps of the 16 bits: half a step of rounding.
Measured: 0.53."""
MIRRORED = 0.93
"""Common over all ink of a drawn ring and its mirror image. Measured: 1.0 and 0.965 (which row a half pixel falls on)."""
SCALE_BAR = 0.02
"""Length of a drawn scale bar, relative, measured by a ring in the same picture: a pixel in 60. Measured: 0.008."""
SAME_PICTURE = 0.99
"""Common over all ink of two drawings of one shape. Measured: 0.9994 or more (MP4 loses a little)."""
MOVED_PICTURE = 0.9
"""The same for successive frames of a film in which a bead moves by several of its radii. Measured: 0.60 at most."""
ELASTICA = 1e-3
"""Tip of a clamped chain of 40 segments against the elastica, over its length; it falls as the square of the segments."""
HELLMANN_FEYNMAN = 1e-5
"""Slope of the energy with the force over 0.2 % of it against the extension: the third derivative, and rounding of the energy."""
FITTED = 1e-5
"""Parameters fitted to a curve without noise. Measured: 1e-7 or less."""
OTHER_FIT = 1e-4
"""The same fit by curve_fit, lmfit or Gauss-Newton: each stops within 1e-5 or so of the minimum."""
OTHER_COVARIANCE = 0.02
"""Standard errors and covariances from their Jacobians, which are differences of unlike steps."""
INTERVAL = 2e-3
"""Ends of an interval over its width: a root found within 1e-3 of a standard error, a grid of 1e-4."""
COVERAGE = 1e-3
"""Probability of counts, or of a distribution, as far off as those found. Seeded: they do not vary."""
FORCE_ERRORS = 0.02
"""Mean of 60 fits to forces that scatter by 5 %: standard error 0.4 %, and the curvature of the fitted curve."""
SHIFT = 0.25
"""The shift of a parameter by a wrong model, to first order, against the one found."""
ERROR_OF_ERROR = 0.15
"""A standard error from some hundreds of effective samples, by two routes."""
FUZZ = 1e-3
"""Forces of random scenes against NumPy, over the largest force of a term: what preflight lets pass without a word."""
FUZZ_AT_REST = 2e-9
"""The same over the force that a strain or angle of one would make: what preflight lets pass where a scene is at rest."""
LINKING = 1e-12
"""Linking numbers and writhes of chains of some 50 segments: integers, 60 digits, other frames and scales. Measured: 1.3e-15;
5e-15 with a corner 1e-2 of a segment from the other curve."""
LINKING_OF_A_PAIR = 1e-14
"""One pair of segments against 60 digits, 1 to 1e-12 of a segment apart. Measured: 8e-16. Over the distance where they run side
by side: there it is what rounding of coordinates does."""
GAUSS_QUADRATURE = 1e-10
"""Gauss integrals by Gauss and Legendre's rule. Measured: 4e-15."""
EXTRAPOLATED_WRITHE = 1e-5
"""Writhe of smooth curves, extrapolated from polygons of 200 and 400 segments. Measured: 1.3e-6 (a helix of 6 turns)."""
CONTACT_SINGLE = 1e-4
"""Contact on OpenMM's CPU platform, in single precision: beads overlap by differences of coordinates near 10."""
COLLISION = 1e-5
"""Verlet, 0.0035 of a period a step: it ends a collision (dt omega)^2/24 = 5e-7 off, and at a step of its own."""
AT_REST_IN_CONTACT = 1e-7
"""Force on a bead at rest over the load on it."""
