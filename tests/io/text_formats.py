"""A small good file of every text format of measured materials, with its readers."""

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

from hshjax import io
from hshjax.io import alta, astm, csv_samples, fred, zemax
from hshjax.io.measured import Measured
from hshjax.samples import Samples

ALTA = b"""#SAMPLE "Gray Tape"
# measured by hand
#DIM 3 1
#VS 0
#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI
#PARAM_OUT INV_STERADIAN_COSINE_FACTOR
0.26179938 -0.52359878 0.1 0.25
0.26179938 0.26179938 0.0 2.5
0.52359878 0.52359878 0.0 1.5e-1
0.52359878 -1.0 -0.3 0.125
0.52359878 1.7 0.0 0.001
"""

FRED = b"""type bsdf_data
format angles=deg bsdf=value scale=1
10\t0
0\t0\t0.052967
10.5\t0\t0.060094
80\t170\t0.003518
30\t0
35\t0\t0.077171
35\t350.5\t0.0671
"""

ASTM = b"""SAMPLE "Blue paint"
DATE 1998-10-13
NUM_POINTS 4
VARS theta_i,phi_i,theta_s,phi_s,R,G,B
0.1,0.0,0.25,3.0,0.1,0.2,0.3
0.1,0.0,0.5,-1.0,0.15,0.25,0.35
0.7,0.5,0.7,3.6,1.5,2.5,3.5e0
0.7,0.5,1.2,0.5,0.01,0.02,-0.03
"""

ZEMAX = b"""# Sample: brown vinyl
# measured once
Source Measured
Symmetry PlaneSymmetrical
SpectralContent Monochrome
ScatterType BRDF
SampleRotation 1
0
AngleOfIncidence 2
10.5 30
ScatterAzimuth 3
0 90 180
ScatterRadial 4
0 5.5 20 60

Monochrome
DataBegin
TIS 0.25
6.0e-02 5.9e-02 5.5e-02 1.1e-02
6.0e-02 5.8e-02 5.4e-02 1.2e-02
6.0e-02 5.7e-02 5.3e-02 1.3e-02
TIS 0.375
7.0e-02 6.9e-02 6.5e-02 2.1e-02
7.0e-02 6.8e-02 6.4e-02 2.2e-02
7.0e-02 6.7e-02 6.3e-02 2.3e-02
DataEnd
"""

CSV = b"""# material: red cloth
# isotropic: false
# units: sr^-1
# cosine_included: true
theta_i [deg],phi_i [deg],theta_o [deg],phi_o [deg],R,G,weight
30,0,45.5,180,0.125,0.08,1
30,90,45.5,-170,0.12,0.07,0.5
60.25,0,10,20,0.11,-0.06,2
"""


@dataclass(frozen=True)
class Format:
    """A small file, how to read it, and where its samples begin."""

    name: str
    content: bytes
    read: Callable[..., Samples]
    measured: Callable[..., Measured]
    module: ModuleType
    first: bytes

    @property
    def header(self) -> int:
        return self.content.index(self.first)


FORMATS = [
    Format("alta", ALTA, io.read_alta, io.measured_alta, alta, b"0.26179938 -0.52"),
    Format("fred", FRED, io.read_fred, io.measured_fred, fred, b"10\t0\n"),
    Format("astm", ASTM, io.read_astm, io.measured_astm, astm, b"0.1,0.0,0.25"),
    Format("zemax", ZEMAX, io.read_zemax, io.measured_zemax, zemax, b"TIS 0.25"),
    Format("csv", CSV, io.read_csv_samples, io.measured_csv_samples, csv_samples, b"30,0,45.5"),
]
