"""The core: what a plan needs for a robot whose file is read. No ring is named here."""
