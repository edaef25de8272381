"""U.S. Standard Atmosphere, 1976 (NASA TM X-74335), to 1000 km: density, temperature, speed of sound.

Altitudes Z are geometric, above the Earth's mean sea level. Up to 86 km the air is mixed, in hydrostatic equilibrium in
layers whose molecular-scale temperature T_M is linear in the geopotential altitude H = r0 Z/(r0 + Z) (section 1.2):

    P = P_b exp(-g0 M0 (H - H_b)/(R T_b))                 or  P_b (T_b/T_M)^(g0 M0/(R L_b)),   rho = P M0/(R T_M)

From there on each gas i diffuses on its own (section 1.3, equations (36) to (39)): N2, O, O2, Ar and He obey

    n_i = n_i7 (T_7/T) exp(-integral of f_i + flux_i)

with the eddy and molecular diffusion in f_i, and hydrogen, which matters above 150 km, escapes at a constant flux.
The integrals are sums over a fine grid that is computed once. Up to 100 km all gases diffuse in air of the molar mass
M0; beyond, oxygen in nitrogen, argon and helium in nitrogen and oxygen (page 14). A program that takes nitrogen's for
atomic oxygen from 86 km on has 0.8 % too much air at 120 km and 7 % at 500 km.

Below, `Z7` and `Z11` are the names that the standard gives its levels of 86 km and 500 km.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

R = 8314.32  # J/(kmol K)
AVOGADRO = 6.022169e26  # 1/kmol
G0, R0 = 9.80665, 6356766.0  # m/s^2, m
M0, RATIO_OF_HEATS = 28.9644, 1.4  # kg/kmol of the mixed air
LOWEST, HIGHEST = -5e3, 1000e3  # m

# Table 4: geopotential altitude [m] at which a layer begins, and its gradient of T_M [K/m].
LAYERS = np.array([0.0, 11e3, 20e3, 32e3, 47e3, 51e3, 71e3])
GRADIENTS = np.array([-6.5e-3, 0.0, 1.0e-3, 2.8e-3, 0.0, -2.8e-3, -2.0e-3])
# Table 8: molar mass beside that of the mixed air, every 500 m from 80 to 86 km.
LIGHTER = np.array([
    1.0, 0.999996, 0.999989, 0.999971, 0.999941, 0.999909, 0.999870, 0.999829, 0.999786, 0.999741, 0.999694, 0.999641,
    0.999579,
])  # fmt: skip

Z7, Z8, Z9, Z10, Z11 = 86e3, 91e3, 110e3, 120e3, 500e3
_T7, _T9, _T10, _T11, _T_FAR = 186.8673, 240.0, 360.0, 999.2356, 1000.0
_STEEP, _FAR = 12e-3, 1.875e-5  # K/m between Z9 and Z10, 1/m beyond
# Molar mass, number density at 86 km [1/m^3], thermal and molecular diffusion (tables 5 to 7).
_GASES = {
    "N2": (28.0134, 1.129794e20, 0.0, None),
    "O": (15.9994, 8.6e16, 0.0, (6.986e20, 0.750)),
    "O2": (31.9988, 3.030898e19, 0.0, (4.863e20, 0.750)),
    "Ar": (39.948, 1.3514e18, 0.0, (4.487e20, 0.870)),
    "He": (4.0026, 7.5817e14, -0.40, (1.700e21, 0.691)),
}
_HYDROGEN = 1.00797  # kg/kmol
_MASSES = {**{gas: values[0] for gas, values in _GASES.items()}, "H": _HYDROGEN}
_H11, _ESCAPE, _H_THERMAL, _H_DIFFUSION = 8.0e10, 7.2e11, -0.25, (3.305e21, 0.500)
_H_FROM = 150e3  # m: below, hydrogen is nothing
# Table 7: Q [1/km^3], U [km], W [1/km^3] of the vertical flux, and those of oxygen's second term below 97 km.
_FLUX = {
    "O": (-5.809644e-4, 56.90311, 2.706240e-5),
    "O2": (1.366212e-4, 86.0, 8.333333e-5),
    "Ar": (9.434079e-5, 86.0, 8.333333e-5),
    "He": (-2.457369e-4, 86.0, 6.666667e-4),
}
_SECOND_FLUX = (-3.416248e-3, 97.0, 5.008765e-4)
_EDDY = 120.0  # m^2/s


def density(altitude: Any) -> Any:
    """Density [kg/m^3] at altitudes [m] between -5 and 1000 km; NaN elsewhere."""
    z = np.asarray(altitude, dtype=float)
    scale, pressure = _lower_atmosphere(np.clip(z, LOWEST, Z7))
    found = np.where(z <= Z7, pressure * M0 / (R * scale), np.exp(np.interp(z, *_upper_density_table())))
    return np.where((z >= LOWEST) & (z <= HIGHEST), found, np.nan)


def temperature(altitude: Any) -> Any:
    """Kinetic temperature [K] at altitudes [m] between -5 and 1000 km; NaN elsewhere."""
    z = np.asarray(altitude, dtype=float)
    lighter = np.interp(z, np.linspace(80e3, Z7, len(LIGHTER)), LIGHTER)
    found = np.where(
        z <= Z7, _lower_atmosphere(np.clip(z, LOWEST, Z7))[0] * lighter, _upper_temperature(np.clip(z, Z7, HIGHEST))
    )
    return np.where((z >= LOWEST) & (z <= HIGHEST), found, np.nan)


def speed_of_sound(altitude: Any) -> Any:
    """Speed of sound [m/s] at altitudes [m] up to 86 km; beyond, where the standard has none, NaN."""
    z = np.asarray(altitude, dtype=float)
    scale, _ = _lower_atmosphere(np.clip(z, LOWEST, Z7))
    return np.where((z >= LOWEST) & (z <= Z7), np.sqrt(RATIO_OF_HEATS * R / M0 * scale), np.nan)


def _lower_atmosphere(z: Any) -> tuple[Any, Any]:
    """Molecular-scale temperature [K] and pressure [Pa] up to 86 km; equations (23) and (33)."""
    h = R0 * z / (R0 + z)
    base, pressures = [288.15], [101325.0]
    for height, begins, gradient in zip(LAYERS[1:], LAYERS, GRADIENTS, strict=False):
        there, falls = _layer(height - begins, base[-1], gradient)
        base.append(float(there))
        pressures.append(pressures[-1] * float(falls))
    k = np.clip(np.searchsorted(LAYERS, h, side="right") - 1, 0, len(LAYERS) - 1)
    scale, falls = _layer(h - LAYERS[k], np.array(base)[k], GRADIENTS[k])
    return scale, np.array(pressures)[k] * falls


def _layer(rise: Any, temperature: Any, gradient: Any) -> tuple[Any, Any]:
    """Temperature, and the share of the pressure that is left, above the begin of a layer."""
    found, weight = temperature + gradient * rise, G0 * M0 / R
    steep = np.where(gradient == 0.0, 1.0, gradient)
    cold = np.exp(-weight * rise / temperature)
    return found, np.where(gradient == 0.0, cold, (temperature / found) ** (weight / steep))


def _upper_temperature(z: Any) -> Any:
    """Kinetic temperature [K] from 86 km on; equations (25) to (31)."""
    rounded = 263.1905 - 76.3232 * np.sqrt(np.maximum(1 - ((z - Z8) / -19942.9) ** 2, 0.0))
    far = _T_FAR - (_T_FAR - _T10) * np.exp(-_FAR * (z - Z10) * (R0 + Z10) / (R0 + z))
    return np.select([z <= Z8, z <= Z9, z <= Z10], [_T7, rounded, _T9 + _STEEP * (z - Z9)], far)


def _temperature_gradient(z: Any) -> Any:
    """Derivative of `_upper_temperature` [K/m]."""
    there = (z - Z8) / -19942.9
    rounded = 76.3232 * there / -19942.9 / np.sqrt(np.maximum(1 - there * there, 1e-12))
    turned = ((R0 + Z10) / (R0 + z)) ** 2
    far = _FAR * (_T_FAR - _T10) * turned * np.exp(-_FAR * (z - Z10) * (R0 + Z10) / (R0 + z))
    return np.select([z <= Z8, z <= Z9, z <= Z10], [0.0, rounded, _STEEP], far)


def _cumulative_trapezoids(values: Any, z: Any) -> Any:
    """Integrals from the lowest altitude on, by trapezoids."""
    from scipy.integrate import cumulative_trapezoid  # only who flies through this air waits for it

    return cumulative_trapezoid(values, z, initial=0.0)


@cache
def _upper_density_table() -> tuple[Any, Any]:
    """Altitudes [m] from 86 km on, and the logarithm of the density there."""
    z = np.concatenate([np.arange(Z7, 150e3, 10.0), np.arange(150e3, Z11, 100.0), np.arange(Z11, HIGHEST + 1, 500.0)])
    t, slope, g = _upper_temperature(z), _temperature_gradient(z), G0 * (R0 / (R0 + z)) ** 2
    numbers: dict[str, Any] = {}
    for gas, (mass, first, thermal, molecular) in _GASES.items():
        through = ("N2", "O", "O2") if gas in ("Ar", "He") else ("N2",)
        beside = {name: numbers[name] for name in through if name in numbers}
        mixed = np.where(z <= 100e3, M0, _mean_mass(beside) if beside else mass)
        if molecular is None:
            rate = mixed * g / (R * t)
        else:
            own = _diffusion(molecular, sum(beside.values()), t)
            rate = _diffusive_settling(z, g, t, slope, mass, thermal, own, mixed) + _flux(gas, z / 1e3) / 1e3
        numbers[gas] = first * (_T7 / t) * np.exp(-_cumulative_trapezoids(rate, z))
    numbers["H"] = _hydrogen(z, g, t, sum(numbers.values()))
    return z, np.log(_mean_mass(numbers) * sum(numbers.values()) / AVOGADRO)


def _mean_mass(numbers: Mapping[str, Any]) -> Any:
    """Molar mass [kg/kmol] of gases by their number densities."""
    return sum(_MASSES[gas] * number for gas, number in numbers.items()) / sum(numbers.values())


def _diffusion(molecular: tuple[float, float], background: Any, t: Any) -> Any:
    """Coefficient of molecular diffusion [m^2/s]; equation (8)."""
    return molecular[0] / background * (t / 273.15) ** molecular[1]


def _diffusive_settling(z: Any, g: Any, t: Any, slope: Any, mass: float, thermal: float, own: Any, beside: Any) -> Any:
    """f of equation (36) [1/m]; above 115 km there are no eddies."""
    eddies = _EDDY * np.exp(1 - 4e8 / np.maximum(4e8 - (z - 95e3) ** 2, 1e6))
    eddies = np.select([z < 95e3, z < 115e3], [_EDDY, eddies], 0.0)
    return g / (R * t) * own / (own + eddies) * (mass + beside * eddies / own + thermal * R * slope / g)


def _flux(gas: str, z: Any) -> Any:
    """Second part of the rate [1/km] up to 150 km, of the altitude in km; equation (37)."""
    strength, at, wide = _FLUX[gas]
    found = strength * (z - at) ** 2 * np.exp(-wide * (z - at) ** 3)
    if gas == "O":
        strength, at, wide = _SECOND_FLUX
        found = found + np.where(z < at, strength * (at - z) ** 2 * np.exp(-wide * np.abs(at - z) ** 3), 0.0)
    return np.where(z <= 150.0, found, 0.0)


def _hydrogen(z: Any, g: Any, t: Any, background: Any) -> Any:
    """Number density [1/m^3] of hydrogen, counted from 500 km; equations (39) and (40)."""
    from_500 = np.searchsorted(z, Z11)

    def since(values: Any) -> Any:
        total = _cumulative_trapezoids(values, z)
        return total - total[from_500]

    tau, warmer = since(_HYDROGEN * g / (R * t)), (t / _T11) ** (1 + _H_THERMAL)
    below = (z >= _H_FROM) & (z <= Z11)
    rising = np.where(below, _ESCAPE / _diffusion(_H_DIFFUSION, background, t) * warmer * np.exp(tau), 0.0)
    return np.where(z >= _H_FROM, (_H11 - since(rising)) / warmer * np.exp(-tau), 0.0)
