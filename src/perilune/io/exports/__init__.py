"""Exports for other programs: tables (NetCDF, CSV, Parquet, frames of pandas, xarray), OEM and CZML."""
