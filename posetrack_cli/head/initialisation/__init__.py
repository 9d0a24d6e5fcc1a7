"""Where a head's track begins: the ten points in space, from several calibrated cameras or from one."""
