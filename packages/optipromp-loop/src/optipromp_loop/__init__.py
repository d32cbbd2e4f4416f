"""The closed loop of looks and motions, the guard of any policy, and adapters of real arms."""
