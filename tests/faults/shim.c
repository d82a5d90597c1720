/* Faults of disk and system, for a program that this is loaded before (LD_PRELOAD).
 *
 * FAULT_CALL   the call that goes wrong: open, read, write, sync or rename; space for a disk that is full after so
 *              many bytes
 * FAULT_AT     which of them: 1 for the first, 0 for all; of space, the number of bytes
 * FAULT_PATH   a part of the path of the files that are concerned
 * FAULT_ERROR  the error: EIO, ENOSPC, ENOENT; KILL and KILLED end the process before and after the call
 * FAULT_HOOK   a shell command that is run at the call in place of an error */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

static atomic_long calls;
static atomic_long bytes;

static const char* setting(const char* name) {
  const char* value = getenv(name);
  return value ? value : "";
}

static int concerns_path(const char* path) {
  const char* part = setting("FAULT_PATH");
  return *part && strstr(path, part) != NULL;
}

static int concerns(int fd) {
  char link[64], path[PATH_MAX];
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  const ssize_t length = readlink(link, path, sizeof path - 1);
  if (length < 0) return 0;
  path[length] = '\0';
  return concerns_path(path);
}

static int is_call(const char* call) { return strcmp(setting("FAULT_CALL"), call) == 0; }

/* Whether this call is the one that goes wrong. */
static int is_due(void) {
  const long at = atol(setting("FAULT_AT"));
  const long number = atomic_fetch_add(&calls, 1) + 1;
  return at == 0 || number == at;
}

static void kill_self(void) {
  kill(getpid(), SIGKILL);
  pause();
}

/* Sets the error; 0 if the call is to be made after all. */
static int fail(void) {
  const char* error = setting("FAULT_ERROR");
  const char* hook = setting("FAULT_HOOK");
  if (*hook) {
    char command[PATH_MAX * 2];
    snprintf(command, sizeof command, "unset LD_PRELOAD FAULT_CALL; %s", hook);
    if (system(command) != 0) abort();
    return 0;
  }
  if (strcmp(error, "KILL") == 0) kill_self();
  errno = strcmp(error, "ENOSPC") == 0 ? ENOSPC : strcmp(error, "ENOENT") == 0 ? ENOENT : EIO;
  return 1;
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static int write_fails(int fd, size_t count) {
  if (is_call("write") && concerns(fd) && is_due()) return fail();
  if (is_call("space") && concerns(fd)) {
    if (atomic_fetch_add(&bytes, (long)count) + (long)count > atol(setting("FAULT_AT"))) {
      errno = ENOSPC;
      return 1;
    }
  }
  return 0;
}

ssize_t write(int fd, const void* data, size_t count) {
  return write_fails(fd, count) ? -1 : REAL(write)(fd, data, count);
}

ssize_t writev(int fd, const struct iovec* parts, int count) {
  size_t size = 0;
  for (int i = 0; i < count; ++i) size += parts[i].iov_len;
  return write_fails(fd, size) ? -1 : REAL(writev)(fd, parts, count);
}

ssize_t read(int fd, void* data, size_t count) {
  if (is_call("read") && concerns(fd) && is_due() && fail()) return -1;
  return REAL(read)(fd, data, count);
}

int fsync(int fd) {
  if (is_call("sync") && concerns(fd) && is_due() && fail()) return -1;
  return REAL(fsync)(fd);
}

int fdatasync(int fd) {
  if (is_call("sync") && concerns(fd) && is_due() && fail()) return -1;
  return REAL(fdatasync)(fd);
}

int rename(const char* from, const char* to) {
  if (is_call("rename") && concerns_path(to) && is_due()) {
    if (strcmp(setting("FAULT_ERROR"), "KILLED") == 0) {
      REAL(rename)(from, to);
      kill_self();
    }
    if (fail()) return -1;
  }
  return REAL(rename)(from, to);
}

static int open_fails(const char* path) {
  return is_call("open") && concerns_path(path) && is_due() && fail();
}

int open(const char* path, int flags, ...) {
  va_list rest;
  va_start(rest, flags);
  const mode_t mode = va_arg(rest, mode_t);
  va_end(rest);
  return open_fails(path) ? -1 : REAL(open)(path, flags, mode);
}

int open64(const char* path, int flags, ...) {
  va_list rest;
  va_start(rest, flags);
  const mode_t mode = va_arg(rest, mode_t);
  va_end(rest);
  return open_fails(path) ? -1 : REAL(open64)(path, flags, mode);
}
