"""Materials as data: isotropic, linear, constant with temperature."""

from __future__ import annotations

from dataclasses import dataclass

from genmf_mi.core.errors import ConfigError


@dataclass(frozen=True)
class Material:
    """An isotropic thermo-elastic solid.

    Raises:
        ConfigError: a constant that must be positive is not, or ν is outside (-1, 0.5).
    """

    name: str
    youngs_modulus_mpa: float
    poisson_ratio: float
    expansion_per_k: float
    conductivity_w_mk: float
    heat_capacity_j_kgk: float
    density_kg_m3: float
    stress_free_celsius: float
    """Temperature at which the part carries no stress: about the glass transition, where stress relaxes quickly."""
    source: str = ""

    def __post_init__(self) -> None:
        for name in (
            "youngs_modulus_mpa",
            "expansion_per_k",
            "conductivity_w_mk",
            "heat_capacity_j_kgk",
            "density_kg_m3",
        ):
            value = getattr(self, name)
            if not 0.0 < value < float("inf"):
                raise ConfigError(f"material {self.name!r}: {name} must be positive and finite, not {value}.")
        if not -1.0 < self.poisson_ratio < 0.5:
            raise ConfigError(
                f"material {self.name!r}: poisson_ratio must lie in (-1, 0.5), not {self.poisson_ratio}; "
                "at 0.5 the solid is incompressible and this formulation locks."
            )
        if not -273.15 < self.stress_free_celsius < float("inf"):
            raise ConfigError(f"material {self.name!r}: stress_free_celsius must be a temperature.")

    @property
    def lame(self) -> tuple[float, float]:
        """Lamé's λ and μ in MPa."""
        e, nu = self.youngs_modulus_mpa, self.poisson_ratio
        return e * nu / ((1 + nu) * (1 - 2 * nu)), e / (2 * (1 + nu))

    @property
    def thermal_modulus(self) -> float:
        """β = (3λ + 2μ) α in MPa/K, the pressure that one kelvin raises in a fully clamped body."""
        lam, mu = self.lame
        return (3 * lam + 2 * mu) * self.expansion_per_k

    @property
    def conductivity_w_mmk(self) -> float:
        return self.conductivity_w_mk * 1e-3

    @property
    def volumetric_heat_j_mm3k(self) -> float:
        """ρ c_p in J/(mm³ K)."""
        return self.density_kg_m3 * 1e-9 * self.heat_capacity_j_kgk


MATERIALS: dict[str, Material] = {
    material.name: material
    for material in (
        Material(
            "pla", 3640.0, 0.36, 41e-6, 0.13, 1800.0, 1240.0, 60.0,
            source="FreeCAD material card PLA-Generic (after the SD3D filament data sheet); MakeItFrom "
            "'Polylactic Acid' agrees on E, k and c_p. Expansion is uncertain: other sheets give up to 101e-6.",
        ),
        Material(
            "petg", 2200.0, 0.38, 68e-6, 0.29, 1200.0, 1270.0, 81.0,
            source="MakeItFrom.com 'Glycol-Modified Polyethylene Terephthalate (PETG, PET-G)': E, α, k, c_p and T₀, "
            "the glass transition. Density is rounded to 1.3 g/cm³ there, 1.27 is usual for filament; ν is not given, "
            "0.38 is our choice.",
        ),
        Material(
            "abs", 2000.0, 0.41, 95e-6, 0.23, 1400.0, 1050.0, 100.0,
            source="MakeItFrom.com 'Unfilled ABS': all but the density, rounded to 1.1 g/cm³ there; common data sheets "
            "give 1.04 to 1.08.",
        ),
        Material(
            "resin", 2800.0, 0.38, 81e-6, 0.20, 1500.0, 1180.0, 73.0,
            source="Typical values, not from one data sheet: E, α and T₀, a deflection temperature, are of the size of "
            "rigid post-cured acrylate resins; ν, k, c_p and ρ are usual for such networks. Resins differ widely: for "
            "its Durable resin, Formlabs gives 1.26 GPa, 145e-6 /K and 43 °C.",
        ),
    )
}  # fmt: skip


def material(name: str) -> Material:
    """The material called ``name``. Raises :class:`ConfigError` with the list of known ones."""
    try:
        return MATERIALS[name.lower()]
    except KeyError:
        raise ConfigError(f"unknown material {name!r}; choose one of {', '.join(MATERIALS)}.") from None
