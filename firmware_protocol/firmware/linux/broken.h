/* SPDX-License-Identifier: MIT */
/* Devices that are broken on purpose, to test the tests of a device. Define one HAPSIM_BROKEN_... of this file. For a
 * wrong state machine, linux/broken changes a copy of hapsim_device.c. */
#ifndef BROKEN_H
#define BROKEN_H

#ifdef HAPSIM_BROKEN_SIGN
#define BROKEN_FORCE(counts) (-(counts))
#else
#define BROKEN_FORCE(counts) (counts)
#endif

#ifdef HAPSIM_BROKEN_SCALE /* as if an encoder's edges were counted twice */
#define BROKEN_POSITION(counts) ((int32_t)(2u * (uint32_t)(counts)))
#else
#define BROKEN_POSITION(counts) (counts)
#endif

#ifdef HAPSIM_BROKEN_ACCELERATION /* mounted the other way round */
#define BROKEN_ACCELERATION(counts) (-(counts))
#else
#define BROKEN_ACCELERATION(counts) (counts)
#endif

#ifdef HAPSIM_BROKEN_RATE /* 2 % too fast */
#define BROKEN_PERIOD(period) ((period) * 50 / 51)
#else
#define BROKEN_PERIOD(period) (period)
#endif

#ifdef HAPSIM_BROKEN_TRANSMITTER /* waits instead of dropping the frame */
#define BROKEN_WAIT(port) (poll(&(struct pollfd){(port), POLLOUT, 0}, 1, 100), !process_stopped)
#else
#define BROKEN_WAIT(port) ((void)(port), false)
#endif

#ifdef HAPSIM_BROKEN_TICK /* the tick dies half a second after arming: the hardware watchdog must end the process */
#define BROKEN_TICK() (hapsim_device_register(HAPSIM_REG_ACCEPTED) > 500)
#else
#define BROKEN_TICK() false
#endif

#endif
