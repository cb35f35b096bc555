"""Scene as data: its roads, what stands and drives there, light, host and shot; assets; changing one."""
