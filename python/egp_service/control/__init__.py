"""Control: commands for a vehicle, computed in this process or asked of the service over zenoh."""
