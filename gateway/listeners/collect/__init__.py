"""Collects what the gateways of a site have stored: each row once, to Parquet files or to PostgreSQL."""
