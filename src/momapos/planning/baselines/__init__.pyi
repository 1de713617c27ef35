from .by_method import plan_by_method as plan_by_method
