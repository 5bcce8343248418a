"""What accuracy costs on this machine, for every application, as one page: `nqr_geom.report`."""
