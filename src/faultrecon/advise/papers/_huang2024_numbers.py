# SPDX-License-Identifier: BSD-3-Clause
"""Errors of the simulations of Huang, Gao, Liu 2024, no code: for every observer the reference, then ours.

By kind (noise or not, root mean square or peak).  The reference is an independent implementation, two or three digits;
None where it says nothing.  Ours are what the observers gave when this was written, noise of seed 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

Kind = tuple[bool, Literal["rmse", "peak"]]
Numbers = Mapping[Kind, dict[str, tuple[tuple[float | None, ...], tuple[float, ...]]]]

ROBOT: Numbers = {
    (False, "rmse"): {
        "printed adaptive, least of 4 F": (
            (0.0012, 0.0015, 0.0015, 0.0021, 0.03, 0.0012),
            (0.001209, 0.001448, 0.00151, 0.002113, 0.03006, 0.001207),
        ),
        "printed adaptive, largest of 4 F": (
            (0.0018, 0.0023, 0.0025, 0.0055, 0.119, 0.0017),
            (0.001803, 0.002306, 0.002473, 0.005519, 0.1191, 0.001708),
        ),
        "adaptive, ρ = 30, certified": (
            (0.0034, 0.0048, 0.0059, 0.0118, 0.27, 0.0047),
            (0.003374, 0.004226, 0.004522, 0.009168, 0.129, 0.005086),
        ),
        "adaptive, ρ = 100, certified": (
            (0.0022, 0.0022, 0.0023, 0.0028, 0.0435, 0.0023),
            (0.002351, 0.002454, 0.002512, 0.003241, 0.04687, 0.002319),
        ),
        "adaptive, ρ = 30": (
            (0.0034, 0.0048, 0.0059, 0.0118, 0.27, 0.0047),
            (0.004353, 0.005403, 0.006254, 0.01144, 0.2327, 0.004978),
        ),
        "adaptive, ρ = 100": (
            (0.0022, 0.0022, 0.0023, 0.0028, 0.0435, 0.0023),
            (0.002888, 0.003024, 0.003183, 0.004041, 0.07372, 0.003464),
        ),
        "printed augmented": (
            (0.0014, 0.0018, 0.029, 0.0138, 0.768, 0.144),
            (0.001391, 0.001831, 0.02895, 0.01375, 0.7676, 0.1443),
        ),
        "augmented, ρ = 30, certified": (
            (0.00021, 0.0002, 0.002, 0.00042, 0.201, 0.0049),
            (0.002787, 0.002804, 0.004999, 0.002941, 0.3674, 0.01139),
        ),
        "augmented, ρ = 100, certified": (
            (0.00024, 0.00022, 0.0014, 0.00034, 0.14, 0.00039),
            (0.001614, 0.001621, 0.002486, 0.001647, 0.1695, 0.001655),
        ),
        "augmented, ρ = 30": (
            (0.00021, 0.0002, 0.002, 0.00042, 0.201, 0.0049),
            (0.0002075, 0.0002078, 0.002178, 0.0004383, 0.2224, 0.00502),
        ),
        "augmented, ρ = 100": (
            (0.00024, 0.00022, 0.0014, 0.00034, 0.14, 0.00039),
            (0.0001802, 0.0001803, 0.001561, 0.000335, 0.1584, 0.0002174),
        ),
        "augmented, ρ = 30, f'' left out": (
            (0.019, 0.0041, 0.093, 0.041, 0.765, 0.183),
            (0.01844, 0.00424, 0.07374, 0.03697, 0.789, 0.1237),
        ),
    },
    (False, "peak"): {
        "printed adaptive, least of 4 F": (
            (None, None, None, None, 0.045, None),
            (0.001712, 0.002508, 0.00333, 0.004374, 0.04506, 0.001707),
        ),
        "printed adaptive, largest of 4 F": (
            (None, None, None, None, 0.172, None),
            (0.002554, 0.003992, 0.006188, 0.009706, 0.1715, 0.002529),
        ),
        "adaptive, ρ = 30, certified": (
            (None, None, None, None, 0.389, None),
            (0.004792, 0.007353, 0.01022, 0.01743, 0.1886, 0.02967),
        ),
        "adaptive, ρ = 100, certified": (
            (None, None, None, None, 0.065, None),
            (0.003335, 0.00402, 0.004777, 0.0067, 0.06993, 0.003289),
        ),
        "adaptive, ρ = 30": (
            (None, None, None, None, 0.389, None),
            (0.006169, 0.009356, 0.01352, 0.02177, 0.3377, 0.006277),
        ),
        "adaptive, ρ = 100": (
            (None, None, None, None, 0.065, None),
            (0.004095, 0.004969, 0.006025, 0.008343, 0.1089, 0.004267),
        ),
        "printed augmented": (
            (None, None, None, None, 1.11, None),
            (0.002559, 0.003388, 0.1082, 0.03817, 1.111, 0.2489),
        ),
        "augmented, ρ = 30, certified": (
            (None, None, None, None, 0.282, None),
            (0.003967, 0.003979, 0.0109, 0.005164, 0.5233, 0.05439),
        ),
        "augmented, ρ = 100, certified": (
            (None, None, None, None, 0.198, None),
            (0.002298, 0.002298, 0.005274, 0.002703, 0.2401, 0.004414),
        ),
        "augmented, ρ = 30": (
            (None, None, None, None, 0.282, None),
            (0.0002943, 0.0002943, 0.004302, 0.0008147, 0.3124, 0.02707),
        ),
        "augmented, ρ = 100": (
            (None, None, None, None, 0.198, None),
            (0.0002557, 0.0002558, 0.003101, 0.0006356, 0.2227, 0.0005095),
        ),
        "augmented, ρ = 30, f'' left out": (
            (None, None, None, None, 1.16, None),
            (0.05409, 0.009666, 0.2117, 0.1018, 1.17, 0.3299),
        ),
    },
    (True, "rmse"): {
        "printed adaptive, least of 4 F": (
            (0.0016, None, None, None, 0.03, None),
            (0.001544, 0.001806, 0.0019, 0.002438, 0.03009, 0.001505),
        ),
        "printed adaptive, largest of 4 F": (
            (0.0021, None, None, None, 0.119, None),
            (0.002098, 0.00249, 0.002698, 0.005606, 0.1191, 0.002003),
        ),
        "adaptive, ρ = 30, certified": (
            (0.0034, None, None, None, 0.27, None),
            (0.003378, 0.004186, 0.004538, 0.009187, 0.1291, 0.005084),
        ),
        "adaptive, ρ = 100, certified": (
            (0.0024, None, None, None, 0.0435, None),
            (0.002412, 0.002476, 0.002586, 0.003306, 0.04688, 0.002368),
        ),
        "adaptive, ρ = 30": (
            (0.0034, None, None, None, 0.27, None),
            (0.00435, 0.005361, 0.006268, 0.01146, 0.2327, 0.004958),
        ),
        "adaptive, ρ = 100": (
            (0.0024, None, None, None, 0.0435, None),
            (0.002951, 0.00305, 0.003258, 0.004108, 0.07373, 0.003512),
        ),
        "printed augmented": (
            (0.0014, None, None, None, 0.768, None),
            (0.001426, 0.00185, 0.02895, 0.01374, 0.7676, 0.1443),
        ),
        "augmented, ρ = 30, certified": (
            (0.0029, None, None, None, 0.201, None),
            (0.002784, 0.002779, 0.005017, 0.002964, 0.3674, 0.01139),
        ),
        "augmented, ρ = 100, certified": (
            (0.0046, None, None, None, 0.14, None),
            (0.001682, 0.001668, 0.002547, 0.001733, 0.1695, 0.001705),
        ),
        "augmented, ρ = 30": (
            (0.0029, None, None, None, 0.201, None),
            (0.00242, 0.002449, 0.003356, 0.002419, 0.2224, 0.005369),
        ),
        "augmented, ρ = 100": (
            (0.0046, None, None, None, 0.14, None),
            (0.003439, 0.00343, 0.003752, 0.003317, 0.1585, 0.003257),
        ),
        "augmented, ρ = 30, f'' left out": (
            (0.019, None, None, None, 0.765, None),
            (0.01845, 0.004228, 0.07375, 0.03697, 0.789, 0.1237),
        ),
    },
    (True, "peak"): {
        "printed adaptive, least of 4 F": (
            (None, None, None, None, None, None),
            (0.004939, 0.006013, 0.00683, 0.008167, 0.04941, 0.005491),
        ),
        "printed adaptive, largest of 4 F": (
            (None, None, None, None, None, None),
            (0.006433, 0.007009, 0.008957, 0.01281, 0.1736, 0.007435),
        ),
        "adaptive, ρ = 30, certified": (
            (None, None, None, None, None, None),
            (0.005093, 0.00767, 0.0108, 0.01792, 0.1887, 0.02993),
        ),
        "adaptive, ρ = 100, certified": (
            (None, None, None, None, None, None),
            (0.004653, 0.005293, 0.006157, 0.008049, 0.07045, 0.004858),
        ),
        "adaptive, ρ = 30": (
            (None, None, None, None, None, None),
            (0.006352, 0.009479, 0.01384, 0.02219, 0.3375, 0.00655),
        ),
        "adaptive, ρ = 100": (
            (None, None, None, None, None, None),
            (0.005493, 0.006121, 0.007426, 0.009897, 0.1096, 0.006415),
        ),
        "printed augmented": (
            (None, None, None, None, None, None),
            (0.002969, 0.003497, 0.1081, 0.03827, 1.111, 0.2487),
        ),
        "augmented, ρ = 30, certified": (
            (None, None, None, None, None, None),
            (0.004261, 0.004243, 0.0111, 0.005558, 0.5233, 0.05452),
        ),
        "augmented, ρ = 100, certified": (
            (None, None, None, None, None, None),
            (0.003654, 0.00362, 0.006281, 0.003917, 0.241, 0.005307),
        ),
        "augmented, ρ = 30": (
            (None, None, None, None, None, None),
            (0.007938, 0.008044, 0.01076, 0.008879, 0.3174, 0.0282),
        ),
        "augmented, ρ = 100": (
            (None, None, None, None, None, None),
            (0.01283, 0.01147, 0.01446, 0.01465, 0.2282, 0.0112),
        ),
        "augmented, ρ = 30, f'' left out": (
            (None, None, None, None, None, None),
            (0.05425, 0.009707, 0.2116, 0.1018, 1.17, 0.3298),
        ),
    },
}
AIRCRAFT: Numbers = {
    (False, "rmse"): {
        "printed adaptive": ((0.0033, 0.0028, 0.0021, 0.0006), (0.003248, 0.002786, 0.002089, 0.0006022)),
        "printed adaptive, F +++": ((None, None, None, None), (0.003247, 0.002776, 0.002088, 0.000589)),
        "adaptive, ρ = 30, certified": ((0.0036, 0.0016, 0.026, 0.026), (0.01018, 0.009738, 0.02262, 0.02261)),
        "adaptive, ρ = 100, certified": ((0.0033, 0.0018, 0.007, 0.0066), (0.003829, 0.002409, 0.01164, 0.01145)),
        "adaptive, ρ = 30": ((0.0036, 0.0016, 0.026, 0.026), (0.003736, 0.003652, 0.04324, 0.04329)),
        "adaptive, ρ = 100": ((0.0033, 0.0018, 0.007, 0.0066), (0.003259, 0.000974, 0.0134, 0.01321)),
        "augmented, ρ = 30, certified": ((0.0032, 0.0028, 0.0022, 0.00078), (0.003248, 0.002766, 0.004053, 0.003498)),
        "augmented, ρ = 30": ((0.0032, 0.0028, 0.0022, 0.00078), (0.00326, 0.00277, 0.002099, 0.0006018)),
    },
    (False, "peak"): {
        "printed adaptive": ((None, None, None, None), (0.003465, 0.00304, 0.002543, 0.00103)),
        "printed adaptive, F +++": ((None, None, None, None), (0.003509, 0.003084, 0.002529, 0.001016)),
        "adaptive, ρ = 30, certified": ((None, None, None, None), (0.01728, 0.01401, 0.04438, 0.04261)),
        "adaptive, ρ = 100, certified": ((None, None, None, None), (0.006392, 0.004392, 0.02102, 0.0193)),
        "adaptive, ρ = 30": ((None, None, None, None), (0.005904, 0.005762, 0.06485, 0.06316)),
        "adaptive, ρ = 100": ((None, None, None, None), (0.003839, 0.001501, 0.02128, 0.01959)),
        "augmented, ρ = 30, certified": ((None, None, None, None), (0.00352, 0.003102, 0.007196, 0.005729)),
        "augmented, ρ = 30": ((None, None, None, None), (0.003641, 0.003228, 0.00275, 0.001108)),
    },
    (True, "rmse"): {
        "printed adaptive": ((None, None, None, 0.0015), (0.003538, 0.003102, 0.00248, 0.001447)),
        "printed adaptive, F +++": ((None, None, None, None), (0.003528, 0.003084, 0.002468, 0.001422)),
        "adaptive, ρ = 30, certified": ((None, None, None, None), (0.01022, 0.009754, 0.02263, 0.02261)),
        "adaptive, ρ = 100, certified": ((None, None, None, None), (0.003874, 0.002439, 0.01165, 0.01145)),
        "adaptive, ρ = 30": ((None, None, None, None), (0.00376, 0.003649, 0.04325, 0.04329)),
        "adaptive, ρ = 100": ((None, None, None, None), (0.003294, 0.001028, 0.01341, 0.01322)),
        "augmented, ρ = 30, certified": ((None, None, None, None), (0.003271, 0.002779, 0.004059, 0.003505)),
        "augmented, ρ = 30": ((None, None, None, None), (0.003336, 0.00285, 0.002194, 0.0008698)),
    },
    (True, "peak"): {
        "printed adaptive": ((None, None, None, None), (0.008363, 0.007755, 0.006993, 0.006899)),
        "printed adaptive, F +++": ((None, None, None, None), (0.008609, 0.008038, 0.007226, 0.007136)),
        "adaptive, ρ = 30, certified": ((None, None, None, None), (0.01753, 0.01441, 0.04465, 0.04292)),
        "adaptive, ρ = 100, certified": ((None, None, None, None), (0.007056, 0.004919, 0.02169, 0.01988)),
        "adaptive, ρ = 30": ((None, None, None, None), (0.00611, 0.006114, 0.06457, 0.06324)),
        "adaptive, ρ = 100": ((None, None, None, None), (0.004525, 0.00222, 0.02166, 0.02036)),
        "augmented, ρ = 30, certified": ((None, None, None, None), (0.004138, 0.003621, 0.007315, 0.006157)),
        "augmented, ρ = 30": ((None, None, None, None), (0.005351, 0.004641, 0.004245, 0.003026)),
    },
}
