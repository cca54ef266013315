"""A phone in the hand: its orientation, by a page of the console."""

from cardan.drivers.handheld import PhoneOptions as PhoneOptions
from cardan.drivers.phone.device import Phone as Phone
