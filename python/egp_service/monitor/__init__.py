"""The live page of vehicles and replicas, served to browsers on this machine."""
