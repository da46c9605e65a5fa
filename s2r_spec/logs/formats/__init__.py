"""Formats of tables: CSV, NPZ, Parquet, and data frames."""
